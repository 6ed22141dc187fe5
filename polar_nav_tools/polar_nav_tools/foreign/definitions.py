"""Definitions of message types whose package is not here and whose bag does not bring them.

Old sqlite3 bags hold bytes without definitions. Types of this project and of ROS come from the
installed packages; the two usual DVL messages stand here. They are the fields alone, in the order
in which they are serialized. Those of other packages are read from a folder of their .msg files.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..bags.errors import BagError
from ..bags.schemas import collect, definition, installed_prefixes, normalize

_SHOWN = 6
_RULE = '=' * 80
_HEADER = f"""{_RULE}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{_RULE}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
_VECTOR = f"""{_RULE}
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
"""

BUNDLED = {
    'marine_acoustic_msgs/msg/Dvl': f"""uint8 DVL_MODE_BOTTOM=1
uint8 DVL_MODE_WATER=2
uint8 DVL_TYPE_PISTON=0
uint8 DVL_TYPE_PHASED_ARRAY=1
std_msgs/Header header
uint8 velocity_mode
uint8 dvl_type
geometry_msgs/Vector3 velocity
float64[9] velocity_covar
float64 altitude
float64 course_gnd
float64 speed_gnd
uint8 num_good_beams
float32 sound_speed
bool beam_ranges_valid
bool beam_velocities_valid
geometry_msgs/Vector3[4] beam_unit_vec
float64[4] range
float32[4] range_covar
float32[4] beam_quality
float32[4] beam_velocity
float32[4] beam_velocity_covar
{_HEADER}{_VECTOR}""",
    'dvl_msgs/msg/DVL': f"""std_msgs/Header header
float64 time
geometry_msgs/Vector3 velocity
float64 fom
float64 altitude
dvl_msgs/DVLBeam[] beams
bool velocity_valid
int64 status
string form
{_RULE}
MSG: dvl_msgs/DVLBeam
int64 id
float64 velocity
float64 distance
float64 rssi
float64 nsd
bool valid
{_HEADER}{_VECTOR}""",
}
"""Message type to its ros2msg text."""


class Definitions:
    """Definitions of types that a bag does not describe.

    Parameters
    ----------
    folder : Path, optional
        Somewhere below it are .msg files, as PACKAGE/msg/NAME.msg or PACKAGE/NAME.msg; they come
        before what is bundled or installed.

    Raises
    ------
    BagError
        When the folder holds no .msg file.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self._files: dict[str, Path] = {}
        if folder is None:
            return
        for file in sorted(folder.rglob('*.msg')):
            package = file.parent.parent if file.parent.name == 'msg' else file.parent
            self._files.setdefault(f'{package.resolve().name}/msg/{file.stem}', file)
        if not self._files:
            raise BagError(f'{folder} holds no .msg file')

    def text_of(self, type_name: str) -> str:
        """Return the ros2msg text of a type.

        Raises
        ------
        BagError
            When it is neither in the folder nor bundled nor installed.
        """
        name = normalize(type_name)
        if name in self._files:
            return collect(name, installed_prefixes(), self._files).text
        if name in BUNDLED:
            return BUNDLED[name]
        try:
            return definition(name).text
        except BagError as error:
            raise BagError(f'the bag does not describe {name}, and {error}') from error


def undecodable(types: Sequence[str]) -> str | None:
    """Return a sentence on types that nobody describes; None where there are none."""
    if not types:
        return None
    some = ', '.join(types[:_SHOWN])
    more = f' and {len(types) - _SHOWN} more' if len(types) > _SHOWN else ''
    n = len(types)
    what = 'type cannot' if n == 1 else 'types cannot'
    return (
        f'{n} {what} be decoded because the bag carries no definitions: {some}{more}; '
        '`--msg-path DIR` takes their .msg files'
    )
