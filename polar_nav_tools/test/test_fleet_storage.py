"""Bags in an S3 bucket and on a web server, both on loopback: figures, requests, sentences."""

import json
import sys

import pyarrow.parquet as pq
import pytest
from fleet_samples import REFERENCE, as_a_new_process, fleet
from test_bags_large_topics import CAMERA, write_with_images

from polar_nav_tools.bags import open_bag
from polar_nav_tools.tasks.rows import VARYING

pytestmark = pytest.mark.slow

FILE = REFERENCE / 'reference_0.mcap'

polar = pytest.fixture(as_a_new_process)


@pytest.fixture(params=['s3', 'web'])
def storage(request):
    return request.getfixturevalue(request.param)


MOST = {'info': 7, 'score': 6, 'replay': 6, 'why': 6, 'doctor': 3, 'verify': 3}
"""Requests for a bag of 2 MB: what lies there, its end, its front, and a piece or two."""


@pytest.mark.parametrize(
    ('command', 'options'),
    [
        ('info', ['--json']),
        ('score', ['--configs', 'default', '--json']),
        ('replay', ['--json']),
        ('why', ['--seq', '7', '--json']),
        ('doctor', ['--json']),
        ('verify', ['--json']),
    ],
)
def test_commands_say_what_they_say_of_the_disk(polar, storage, command, options):
    url = storage.put(FILE, '2026/reference.mcap')
    here = polar(command, FILE, *options)
    storage.log.clear()
    there = polar(command, url, *options)
    assert there[0] == here[0] == 0
    mine, other = json.loads(here[1]), json.loads(there[1])
    assert other.get('path', other.get('bag')) == url
    for named in ('path', 'bag', 'files', 'is_verified'):
        mine.pop(named, None)
        other.pop(named, None)
    assert other == mine
    assert len(storage.log) <= MOST[command]
    assert storage.log.count('HEAD') == 1


def test_a_page_says_how_far_a_bag_is_verified(polar, storage):
    url = storage.put(FILE, 'a.mcap')
    assert 'yes, by its index; `polar doctor` reads it all' in polar('info', url)[1]


@pytest.mark.parametrize('command', [['info'], ['score', '--configs', 'default']])
def test_a_bag_without_an_index_is_read_whole_and_says_so(polar, web, command):
    data = FILE.read_bytes()[:1_500_000]
    url = web.put(data, 'cut.mcap')
    status, _, err = polar(command[0], url, *command[1:])
    assert status == 1
    assert f'{url}: has no whole index; all its 1500000 bytes are read' in err
    assert 'bytes are ignored' in err


@pytest.mark.parametrize('command', ['report', 'recover'])
def test_nothing_is_written_to_an_address(polar, web, command):
    status, _, err = polar(command, web.put(FILE, 'a.mcap'))
    assert (status, list(web.log)) == (2, [])
    assert 'cannot be written to' in ' '.join(err.replace('│', ' ').split())


def test_large_topics_are_left_where_they_are(tmp_path, storage):
    path, said = write_with_images(tmp_path / 'b', 100, 1 << 20, every=25)
    bag = open_bag(storage.put(path, 'a.mcap'))
    assert bag.topics[CAMERA].count == 4
    imu = next(t for t in bag.topics if t.endswith('imu/data_raw'))
    assert list(bag.payloads(imu)) == [data for topic, data in said if topic == imu]
    assert len(storage.log) <= 3 + 4  # one for each stretch between images
    assert bag.files[0].copy.bytes < path.stat().st_size / 10


def test_a_fleet_in_a_bucket(polar, s3, tmp_path):
    folder = fleet(tmp_path / 'here')
    for path in folder.rglob('*.mcap'):
        s3.put(path, f'2026/{path.relative_to(folder)}')
    options = ('--configs', 'default', '--out', 'scores.parquet', '--jobs', '1')
    polar('score', folder / '**/*.mcap', *options)
    here = pq.read_table('scores.parquet').to_pylist()
    s3.log.clear()
    status, _, err = polar('score', 's3://fleet/**/*.mcap', *options)
    assert status == 1
    assert 's3://fleet/2026/c/text.mcap is not an MCAP file' in err
    there = pq.read_table('scores.parquet').to_pylist()
    other = {'key', 'bag', 'verified', 'content', 'reason', *VARYING}
    assert [{k: v for k, v in r.items() if k not in other} for r in here] == (
        [{k: v for k, v in r.items() if k not in other} for r in there]
    )
    assert s3.log.count('HEAD') == 3
    assert len(s3.log) <= 1 + 3 * MOST['score']
    s3.log.clear()
    status, _, err = polar('score', 's3://fleet/**/*.mcap', *options, '--resume')
    assert (status, len(s3.log)) == (1, 1)  # the listing tells it all
    assert '3 of 3 rows were there already' in err
    s3.put(folder / 'a/whole.mcap', '2026/c/text.mcap')  # what was wrong is put right
    s3.log.clear()
    assert polar('score', 's3://fleet/**/*.mcap', *options, '--resume')[0] == 0
    assert s3.log.count('HEAD') == 1


def test_processes_read_the_bucket_themselves(polar, s3, monkeypatch):
    monkeypatch.setenv('PYTHONPATH', ':'.join(p for p in sys.path if p))
    for name in 'abc':
        s3.put(FILE, f'{name}/{name}.mcap')
    options = ('--configs', 'default,modified_akf', '--out', 'scores.parquet')
    assert polar('score', 's3://fleet/**/*.mcap', *options, '--jobs', '2')[0] == 0
    two = pq.read_table('scores.parquet').drop_columns(list(VARYING))
    assert polar('score', 's3://fleet/**/*.mcap', *options, '--jobs', '1')[0] == 0
    assert pq.read_table('scores.parquet').drop_columns(list(VARYING)).equals(two)
    assert two.num_rows == 6


# -- sentences ------------------------------------------------------------------------------------


def test_what_is_not_there(polar, storage):
    url = storage.put(FILE, 'a.mcap').replace('a.mcap', 'b.mcap')
    status, out, err = polar('info', url)
    assert (status, out, err) == (2, '', f'polar: {url} does not exist\n')


def test_a_bucket_that_is_not_there(polar, s3):
    assert s3.endpoint
    status, _, err = polar('info', 's3://other/a.mcap')
    assert (status, err) == (
        2,
        'polar: s3://other/a.mcap does not exist: there is no such bucket\n',
    )


def test_no_credentials(polar, s3, monkeypatch):
    url = s3.put(FILE, 'a.mcap')
    for name in ('AWS_ACCESS_KEY_ID', 'AWS_SECRET_ACCESS_KEY'):
        monkeypatch.delenv(name)
    monkeypatch.setenv('HOME', '/nonexistent')
    import s3fs

    s3fs.S3FileSystem.clear_instance_cache()
    status, _, err = polar('info', url)
    assert status == 1
    assert f'{url}: cannot be read (no credentials: AWS_ACCESS_KEY_ID' in err
    assert err.count('\n') == 1


def test_nobody_listens(polar, web):
    url = web.put(FILE, 'a.mcap')
    web.stop()
    status, _, err = polar('info', url)
    assert status == 1
    assert err.startswith(f'polar: {url}: cannot be read (')
    assert err.count('\n') == 1


def test_no_bucket_server_listens(polar, s3, monkeypatch):
    url = s3.put(FILE, 'a.mcap')
    monkeypatch.setenv('AWS_ENDPOINT_URL', 'http://127.0.0.1:1')
    import s3fs

    s3fs.S3FileSystem.clear_instance_cache()
    status, _, err = polar('info', url)
    assert status == 1
    assert err.startswith(f'polar: {url}: cannot be read (')
    assert err.count('\n') == 1


@pytest.mark.parametrize('status', [401, 403])
def test_access_denied(polar, web, status):
    url = web.put(FILE, 'a.mcap')
    web.status = status
    found, _, err = polar('info', url)
    assert found == 1
    assert f'{url}: cannot be read (access denied: {status}' in err


def test_a_server_that_breaks(polar, web):
    url = web.put(FILE, 'a.mcap')
    web.status = 500
    found, _, err = polar('info', url)
    assert found == 1
    assert f'{url}: cannot be read (500' in err


def test_a_server_without_ranges_is_not_asked_for_a_whole_bag(polar, web):
    url = web.put(FILE.read_bytes() * 20, 'a.mcap')
    web.ranges = False
    found, _, err = polar('info', url)
    assert found == 1
    assert 'the server sends a file as a whole only' in err
    assert web.log.count('GET') == 1


def test_a_server_that_tells_no_size(polar, web):
    url = web.put(FILE, 'a.mcap')
    web.sizes = False
    found, _, err = polar('info', url)
    assert (found, err) == (1, f'polar: {url}: the server does not say how large it is\n')
