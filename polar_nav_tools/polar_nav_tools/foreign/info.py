"""Facts about a bag of another kind than MCAP, for `./polar info`."""

from __future__ import annotations

from ..bags.errors import BagError
from ..bags.info import BagInfo, TopicInfo
from .sources import Source


def source_info(source: Source) -> BagInfo:
    """Collect the facts in one pass over the messages.

    Raises
    ------
    BagError
        When the bag is damaged, or holds no message.
    """
    times: dict[str, tuple[int, int]] = {}
    for name, log_ns, _ in source.fronts():
        first, last = times.get(name, (log_ns, log_ns))
        times[name] = (min(first, log_ns), max(last, log_ns))
    if not times:
        raise BagError(f'{source.path} holds no message')
    start_ns, stop_ns = min(t[0] for t in times.values()), max(t[1] for t in times.values())
    topics = []
    for topic in source.topics.values():
        own = times.get(topic.name)
        first_ns, last_ns = (None, None) if own is None else own
        rate = None
        if own is not None and own[1] > own[0]:
            rate = (topic.count - 1) * 1e9 / (own[1] - own[0])
        topics.append(TopicInfo(topic.name, topic.type, topic.count, rate, first_ns, last_ns))
    files = [source.path] if source.path.is_file() else sorted(source.path.glob('*.db3'))
    size = sum(file.stat().st_size for file in files)
    return BagInfo(
        path=str(source.path),
        files=tuple(file.name for file in files),
        size_bytes=size,
        uncompressed_bytes=size,
        ignored_bytes=0,
        compression='compression not known',
        library=source.kind,
        message_count=sum(topic.count for topic in topics),
        start_ns=start_ns,
        stop_ns=stop_ns,
        duration_s=(stop_ns - start_ns) / 1e9,
        topics=tuple(topics),
        nodes={},
        run_info={},
        is_complete=not source.problems,
        problems=tuple(source.problems),
    )
