"""Writer of a rosbag2 bag: MCAP of serialized messages, readable up to a kill of the process.

In: serialized messages (CDR bytes) with their times. Out: ``<name>/<name>_0.mcap`` and, when
finished, ``<name>/metadata.yaml``. The file is MCAP with profile ``ros2``: chunks of about
256 kB, each with its checksum and index, definitions of all types embedded, a checksum over
everything. The run is described twice, right at the start and at the end, in metadata records
named ``polar_nav_run`` and ``polar_nav_run_end`` (a key per item, its value as JSON): two names,
since viewers join records of one name to one record.

A topic with large messages (`LARGE_BYTES`: images, sonar) has chunks of its own from its first
large message on, in the order of recording all the same: whoever wants the others, by requests
for parts of a file far away, need not fetch it.

Nothing waits long in memory: a chunk goes to the operating system when it is full and at least
every `flush_s` seconds, so killing the process loses the messages of that time.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from . import qos, rosbag2_metadata
from .contents import SEQUENCE_KEY
from .earlier import with_earlier_files
from .errors import BagError
from .mcap_writer import COMPRESSIONS, LIBRARY, declare_silent, make_writer
from .qos import Qos
from .rosbag2_metadata import TopicSummary
from .run_records import PHASE_KEY, RUN_END_RECORD, RUN_RECORD
from .schemas import Definition, definition
from .sink import Sink

LARGE_BYTES = 64 * 1024
"""Size of a message from which its topic is kept apart [bytes]."""
_U32 = 0xFFFFFFFF


@dataclass
class _Channel:
    id: int
    definition: Definition
    qos: tuple[Qos, ...]
    encoding: str
    count: int = 0
    is_large: bool = False


class BagWriter:
    """Writer of one bag.

    Used as a context manager it finishes the bag, or abandons it when an exception passes: the
    file then has no index, and everything written so far can still be read.

    Parameters
    ----------
    directory : Path
        The bag; must not exist, unless it is resumed. Its name becomes the name of the file in it.
    run_info : mapping
        Description of the run: seeds, versions, git commit, mission, command line; values for
        JSON.
    compression : str
        ``zstd``, ``lz4`` or ``none``.
    chunk_bytes : int
        Uncompressed size at which a chunk is closed.
    flush_s : float
        Longest time that a message stays in memory while messages come in [s]; `tick` keeps it
        when they do not.
    sync : bool
        Also wait for the disk at each flush, so that a loss of power costs no more than a kill.
    resume : bool
        Go on in a next file, ``<name>_1.mcap``, where the bag exists; its files stay as they are.
    clock : callable
        Seconds of a monotonic clock; another one in tests.

    Raises
    ------
    BagError
        If the directory exists or cannot be made, or the disk is full.
    """

    def __init__(
        self,
        directory: Path,
        run_info: Mapping[str, object],
        *,
        compression: str = 'zstd',
        chunk_bytes: int = 256 * 1024,
        flush_s: float = 0.5,
        sync: bool = False,
        resume: bool = False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        if compression not in COMPRESSIONS:
            raise BagError(f'compression {compression!r} is none of {", ".join(COMPRESSIONS)}')
        self.directory = Path(directory)
        self._run_info = dict(run_info)
        start = _json_values(self._run_info, 'run_info') | {PHASE_KEY: 'start'}
        opened = Sink.of_next_file if resume else Sink.of_new_bag
        self._sink = opened(self.directory)
        self.path = self._sink.path
        self._flush_s = flush_s
        self._sync = sync
        self._clock = clock
        self._channels: dict[str, _Channel] = {}
        self._schemas: dict[str, int] = {}
        self._count = 0
        self._safe_count = 0
        self._safe_size = 0  # of the file when the last chunk was written
        self._start_ns = 0
        self._stop_ns = 0
        self._unflushed = False
        self._apart = (
            0  # channel that has the present chunk for itself; 0: the chunk is of all others
        )
        self.metadata: dict[str, Any] = {}
        """What metadata.yaml says of this file, once it is finished."""
        self._mcap = make_writer(self._sink, compression, chunk_bytes)
        with self._explained():
            self._mcap.start(profile='ros2', library=LIBRARY)
            self._mcap.add_metadata(RUN_RECORD, start)
            self._sink.sync()
        self._safe_size = self._sink.tell()
        self._next_flush = clock() + flush_s

    @property
    def message_count(self) -> int:
        """Number of messages passed to `write`."""
        return self._count

    @property
    def size(self) -> int:
        """Size of the file so far [bytes]."""
        return self._sink.tell()

    @property
    def counts(self) -> dict[str, int]:
        """Number of messages per topic, topics without any included."""
        return {name: c.count for name, c in self._channels.items()}

    def add_topic(
        self,
        topic: str,
        type_name: str,
        *,
        offered: Sequence[Qos] = (),
        described: Definition | None = None,
        encoding: str = 'cdr',
        schema_encoding: str = 'ros2msg',
        counted: bool = True,
    ) -> None:
        """Register a topic; must precede its first message.

        Parameters
        ----------
        topic, type_name : str
            Fully qualified topic; message type, ``package/msg/Name``.
        offered : sequence of Qos
            Profiles that the publishers offered; the project's own profile if empty.
        described : Definition, optional
            Definition from elsewhere (another bag); by default that of the installed package.
        encoding, schema_encoding : str
            Of the messages and of the definition.
        counted : bool
            Whether sequence numbers count the messages from 1, so that a reader can count the
            missing ones.

        Raises
        ------
        BagError
            If the topic is registered already or the type has no definition.
        """
        if topic in self._channels:
            raise BagError(f'{self.path}: topic {topic} was added before')
        described = described if described is not None else definition(type_name)
        offered = tuple(offered) or (Qos(),)
        if described.type and described.type not in self._schemas:
            self._schemas[described.type] = self._mcap.register_schema(
                described.type, schema_encoding, described.text.encode()
            )
        metadata = {'offered_qos_profiles': qos.to_yaml(offered)}
        if counted:
            metadata[SEQUENCE_KEY] = 'count'
        if described.type_hash:
            metadata['topic_type_hash'] = described.type_hash
        channel_id = self._mcap.register_channel(
            topic, encoding, self._schemas.get(described.type, 0), metadata
        )
        self._channels[topic] = _Channel(channel_id, described, offered, encoding)

    def write(
        self,
        topic: str,
        data: bytes,
        log_time_ns: int,
        publish_time_ns: int | None = None,
        sequence: int | None = None,
    ) -> None:
        """Append one serialized message.

        Parameters
        ----------
        topic : str
            Added before.
        data : bytes
            As it arrived, encapsulation header included.
        log_time_ns, publish_time_ns : int
            See bags/README.md; publish time defaults to the log time.
        sequence : int, optional
            By default messages of a topic are counted from 1; `recover` passes the old numbers.

        Raises
        ------
        BagError
            If the disk is full or the file cannot be written for another reason. Flushed messages
            stay readable; the writer can only be abandoned.
        """
        channel = self._channels[topic]
        if len(data) >= LARGE_BYTES:
            channel.is_large = True
        if (channel.id if channel.is_large else 0) != self._apart:
            self._turn_to(channel)
        channel.count += 1
        if self._count == 0:
            self._start_ns = self._stop_ns = log_time_ns
        else:
            self._start_ns = min(self._start_ns, log_time_ns)
            self._stop_ns = max(self._stop_ns, log_time_ns)
        self._count += 1
        self._unflushed = True
        try:  # not the context manager: this runs thousands of times a second
            self._mcap.add_message(
                channel.id,
                log_time_ns,
                data,
                log_time_ns if publish_time_ns is None else publish_time_ns,
                (channel.count if sequence is None else sequence) & _U32,
            )
        except OSError as error:
            raise self._failure(error) from error
        if self._sink.tell() != self._safe_size:  # the chunk was full and is written
            self._note_safe()
        if self._clock() >= self._next_flush:
            self.flush()

    def _turn_to(self, channel: _Channel) -> None:
        """End the present chunk, where it is not for this channel."""
        if self._unflushed:
            with self._explained():
                self._mcap.flush()
            self._note_safe()
        self._apart = channel.id if channel.is_large else 0

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record at once."""
        with self._explained():
            self._mcap.add_metadata(name, dict(values))
        self._safe_size = self._sink.tell()  # messages still wait in the chunk

    def tick(self) -> None:
        """Flush if it is due; for timers, so that the last messages before a pause are written."""
        if self._clock() >= self._next_flush:
            self.flush()

    def flush(self) -> None:
        """Close the current chunk and write it to the file."""
        self._next_flush = self._clock() + self._flush_s
        self._check_place()
        if not self._unflushed:
            return
        with self._explained():
            self._mcap.flush()
            if self._sync:
                self._sink.sync()
        self._note_safe()

    def finish(
        self,
        end_info: Mapping[str, object] | None = None,
        earlier: Mapping[Path, Mapping[str, Any]] | None = None,
    ) -> Path:
        """Write the final description, the index and metadata.yaml; returns the bag's directory.

        Parameters
        ----------
        end_info : mapping
            Items known only at the end (counts, losses); joined to the description of the start.
        earlier : mapping of Path to mapping, optional
            `metadata` of files of this bag before; others are read.
        """
        self.finish_file(end_info)
        with self._explained():
            whole = with_earlier_files(self.path, self.metadata, earlier or {})
            rosbag2_metadata.write(self.directory, whole)
        return self.directory

    def finish_file(self, end_info: Mapping[str, object] | None = None) -> None:
        """Write the final description and the index; the bag goes on in a next file."""
        info = self._run_info | dict(end_info or {})
        end = _json_values(info, 'end_info') | {PHASE_KEY: 'end'}
        metadata = rosbag2_metadata.bag_metadata(
            self.path.name, self._summary(), self._start_ns, self._stop_ns
        )
        self._check_place()
        with self._explained():
            self._mcap.flush()
            self._note_safe()
            declare_silent(self._mcap, [c.id for c in self._channels.values() if not c.count])
            self._mcap.add_metadata(RUN_END_RECORD, end)
            # `ros2 bag` reads this one if the path is the file's, not its directory's.
            serialized = {'serialized_metadata': rosbag2_metadata.dump(metadata)}
            self._mcap.add_metadata('rosbag2', serialized)
            self._mcap.finish()
            self._sink.sync()
            self._sink.close()
        self.metadata = metadata

    def abandon(self) -> None:
        """Close the file as it is; the messages of the current chunk are lost."""
        self._sink.close()

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Finish the bag, or abandon it if the block failed."""
        if self._sink.closed:
            return
        if kind is None:
            self.finish()
        else:
            self.abandon()

    def _check_place(self) -> None:
        """Raise BagError unless the file still exists: writes to a removed one succeed."""
        if not self._sink.is_in_place():
            raise BagError(
                f'{self.path} was removed or moved while it was being written; if removed, its '
                f'{self._count} messages are lost'
            )

    def _note_safe(self) -> None:
        """Store that all messages up to here are in the file."""
        self._safe_size = self._sink.tell()
        self._safe_count = self._count
        self._unflushed = False

    def _summary(self) -> list[TopicSummary]:
        return [
            TopicSummary(
                name, c.definition.type, c.count, c.definition.type_hash, c.qos, c.encoding
            )
            for name, c in self._channels.items()
        ]

    @contextmanager
    def _explained(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise self._failure(error) from error

    def _failure(self, error: OSError) -> BagError:
        if self._sink.tell() != self._safe_size:  # the chunk was written, its index was not
            self._note_safe()
        return BagError(
            f'{self.path}: cannot be written any more ({error.strerror or error}); '
            f'the first {self._safe_count} messages are in it and can be read'
        )


def _json_values(info: Mapping[str, object], what: str) -> dict[str, str]:
    try:
        return {str(k): json.dumps(v, sort_keys=True) for k, v in info.items()}
    except (TypeError, ValueError) as error:
        raise BagError(f'{what} has a value that JSON cannot hold: {error}') from error
