"""Storages on the loopback interface for tests: an S3 server (moto), and a plain HTTP server."""

import logging
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.request import Request, urlopen

import pytest

WHY = 'no storage on loopback: pip install -r tests/storage_requirements.txt'


class Log(list):
    """Requests so far: method, path and range."""

    def count(self, method):
        return sum(one[0] == method for one in self)


class S3:
    """S3 server of moto with one bucket."""

    def __init__(self, log):
        from moto.server import ThreadedMotoServer

        logging.getLogger('werkzeug').setLevel('ERROR')
        self.log = log
        self._server = ThreadedMotoServer(ip_address='127.0.0.1', port=0, verbose=False)
        self._server.start()
        host, port = self._server.get_host_and_port()
        self.endpoint = f'http://{host}:{port}'

    def begin(self):
        import boto3

        # The servers of one process share what was put there.
        urlopen(Request(f'{self.endpoint}/moto-api/reset', method='POST')).close()
        self._client = boto3.client('s3')
        self._client.create_bucket(Bucket='fleet')

    def put(self, source, name):
        data = source if isinstance(source, bytes) else Path(source).read_bytes()
        self._client.put_object(Bucket='fleet', Key=name, Body=data)
        return f's3://fleet/{name}'

    def stop(self):
        self._server.stop()


class Server(ThreadingHTTPServer):
    request_queue_size = 128  # of the usual five connections the kernel drops some and waits


class Web:
    """HTTP server of some files; can do without ranges, sizes, and everything."""

    def __init__(self):
        self.log, self.files = Log(), {}
        self.ranges = self.sizes = True
        self.status = 200
        outer = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = 'HTTP/1.1'

            def do_HEAD(self):
                self._answer()

            def do_GET(self):
                self._answer()

            def log_message(self, *_):
                pass

            def _answer(self):
                asked = self.headers.get('Range')
                outer.log.append((self.command, self.path, asked))
                data = outer.files.get(self.path)
                if data is None or outer.status != 200:
                    self.send_error(404 if data is None else outer.status)
                    return
                part, status = data, 200
                if asked is not None and outer.ranges:
                    first, last = asked.removeprefix('bytes=').split('-')
                    part, status = data[int(first) : int(last) + 1], 206
                self.send_response(status)
                if status == 206:
                    self.send_header('Content-Range', f'bytes {first}-{last}/{len(data)}')
                if outer.sizes:
                    self.send_header('Content-Length', str(len(part)))
                else:
                    self.send_header('Connection', 'close')
                self.send_header('ETag', f'"{hash(data)}"')
                self.end_headers()
                if self.command == 'GET':
                    try:
                        self.wfile.write(part)
                    except OSError:  # who asked has seen enough
                        self.close_connection = True

        self._server = Server(('127.0.0.1', 0), Handler)
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()
        self.url = f'http://127.0.0.1:{self._server.server_address[1]}'

    def put(self, source, name):
        data = source if isinstance(source, bytes) else Path(source).read_bytes()
        self.files[f'/{name}'] = data
        return f'{self.url}/{name}'

    def stop(self):
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


@pytest.fixture
def s3(monkeypatch):
    """S3 server with the bucket ``fleet``, named by environment variables as any other."""
    pytest.importorskip('moto', reason=WHY)
    s3fs = pytest.importorskip('s3fs', reason=WHY)
    from moto.moto_server.werkzeug_app import DomainDispatcherApplication as Application

    log, answer = Log(), Application.__call__

    def logged(self, environment, start):
        asked = environment.get('HTTP_RANGE')
        log.append((environment['REQUEST_METHOD'], environment['PATH_INFO'], asked))
        return answer(self, environment, start)

    monkeypatch.setattr(Application, '__call__', logged)
    server = S3(log)
    for name, value in {
        'AWS_ACCESS_KEY_ID': 'any',
        'AWS_SECRET_ACCESS_KEY': 'any',
        'AWS_DEFAULT_REGION': 'us-east-1',
        'AWS_EC2_METADATA_DISABLED': 'true',
        'AWS_MAX_ATTEMPTS': '1',
        'AWS_ENDPOINT_URL': server.endpoint,
    }.items():
        monkeypatch.setenv(name, value)
    for name in ('AWS_PROFILE', 'AWS_SESSION_TOKEN'):
        monkeypatch.delenv(name, raising=False)
    s3fs.S3FileSystem.clear_instance_cache()
    server.begin()
    log.clear()
    yield server
    s3fs.S3FileSystem.clear_instance_cache()
    server.stop()


@pytest.fixture
def web():
    """HTTP server."""
    pytest.importorskip('aiohttp', reason=WHY)
    server = Web()
    yield server
    server.stop()
