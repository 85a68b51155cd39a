"""`godwit view` beside a godwitd that flies: a headless Chromium opens its page, and what is shown there changes; the
socket that goes and comes back; a port that is taken; requests that are none.

  view_test.py GODWIT GODWITD [PICTURE.png]
"""
import atexit
import html.parser
import http.server
import json
import os
import pathlib
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import urllib.error
import urllib.request

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent.parent))
from flying_daemon import PATIENCE_S, Daemon, fail  # noqa: E402

GODWIT, GODWITD = sys.argv[1:3]
BROWSER = 'chromium-headless-shell'
LOOK_ON = pathlib.Path(__file__).resolve().parents[2] / 'benchmarks/look_on'
LOOK_S = 60  # at most
# Said by a script that the test adds: what the page shows, until it has been seen to change.
WATCH = '''<script>
const seen = { frames: new Set(), state: new Set(), picture: new Set(), track: new Set(), pixels: new Set(), trouble: new Set() };
function look() {
  for (const id of ['frames', 'state', 'trouble']) seen[id].add(document.getElementById(id).textContent);
  seen.picture.add(document.getElementById('picture_about').textContent);
  seen.track.add(document.getElementById('track_about').textContent);
  const ink = id => [...document.getElementById(id).toDataURL()].reduce((sum, x) => (sum * 31 + x.charCodeAt(0)) % 1000003, 7);
  seen.pixels.add(ink('picture') + ' ' + ink('track'));
  document.body.dataset.seen = JSON.stringify(seen, (k, v) => v instanceof Set ? [...v] : v);
  document.body.dataset.wide = document.documentElement.scrollWidth <= innerWidth;
  const enough = seen.frames.size > 4 && seen.picture.size > 4 && seen.track.size > 2 && seen.pixels.size > 4;
  if (enough || performance.now() > LOOK_MS) fetch('/enough'); else setTimeout(look, 100);
}
look();
</script><img src="/hold" alt="">'''


def get(port, path, host=None):
    request = urllib.request.Request(f'http://127.0.0.1:{port}{path}', headers={'Host': host} if host else {})
    with urllib.request.urlopen(request, timeout=20) as answer:
        return answer


def text_of(port, path):
    with urllib.request.urlopen(f'http://127.0.0.1:{port}{path}', timeout=20) as answer:
        return answer.read().decode()


def until(what, found):
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        value = found()
        if value:
            return value
        time.sleep(0.1)
    return fail(what)


class View:
    def __init__(self, *options):
        self.process = subprocess.Popen([GODWIT, 'view', *map(str, options)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        atexit.register(self.process.kill)
        line = self.process.stdout.readline()
        found = re.match(r'http://127\.0\.0\.1:(\d+)/ shows ', line)
        if not found:
            fail(f'it does not say where it is: {line} {self.process.stderr.read()}')
        self.port = int(found.group(1))

    def status(self):
        return json.loads(text_of(self.port, '/status'))

    def end(self):
        self.process.send_signal(signal.SIGINT)
        if self.process.wait(20) != 0:
            fail(f'it ends with {self.process.returncode}: {self.process.stderr.read()}')


class Between(http.server.BaseHTTPRequestHandler):
    """Hands everything on to the view, adds the watching script to its page, and keeps the page loading until enough is seen."""
    port = 0
    enough = threading.Event()

    def do_GET(self):
        if self.path == '/enough':
            self.enough.set()
            return self.tell('text/plain', b'')
        if self.path == '/hold':
            self.enough.wait(LOOK_S + 10)
            return self.tell('image/gif', b'')
        with urllib.request.urlopen(f'http://127.0.0.1:{self.port}{self.path}', timeout=20) as answer:
            body = answer.read()
            # As strict as it is served, but for the picture that holds it.
            policy = answer.headers['Content-Security-Policy'].replace("img-src data:", "img-src data: 'self'")
            if self.path == '/':
                body = body.replace(b'</body>', WATCH.replace('LOOK_MS', str(LOOK_S * 1000)).encode() + b'</body>')
            return self.tell(answer.headers['Content-Type'], body, policy)

    def tell(self, kind, body, policy=None):
        self.send_response(200)
        self.send_header('Content-Type', kind)
        self.send_header('Content-Length', str(len(body)))
        if policy:
            self.send_header('Content-Security-Policy', policy)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_):
        pass


def browse(view, folder):
    if not shutil.which(BROWSER):
        if os.environ.get('CI') == 'true':
            fail(f'{BROWSER} is not there: scripts/setup installs it')
        print(f'{BROWSER} is not there (scripts/setup): the page was not opened')
        return
    Between.port = view.port
    server = http.server.ThreadingHTTPServer(('127.0.0.1', 0), Between)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    want = [f'--screenshot={sys.argv[3]}'] if len(sys.argv) > 3 else ['--dump-dom']
    done = subprocess.run([BROWSER, '--no-sandbox', '--disable-gpu', '--enable-logging=stderr', '--window-size=1200,1000',
                           '--disable-background-networking', '--disable-dev-shm-usage', '--no-first-run',
                           f'--user-data-dir={folder}/browser', *want, f'http://127.0.0.1:{server.server_port}/'],
                          capture_output=True, text=True, timeout=240, check=False)
    server.shutdown()
    if done.returncode != 0:
        fail(done.stderr)
    spoken = [line for line in done.stderr.splitlines() if 'CONSOLE' in line]
    if spoken:
        fail(f'the browser has something to say: {spoken}')
    if len(sys.argv) > 3:
        return
    body = {}

    class Body(html.parser.HTMLParser):
        def handle_starttag(self, tag, attributes):
            if tag == 'body':
                body.update(attributes)

    Body().feed(done.stdout)
    seen = json.loads(body['data-seen'])
    for what, least in (('frames', 5), ('picture', 5), ('track', 3), ('pixels', 5)):
        if len(seen[what]) < least:
            fail(f'{what} does not change: {seen}')
    if 'TRACKING' not in seen['state'] or body['data-wide'] != 'true':
        fail(f'{seen["state"]}, fits the window: {body["data-wide"]}')
    if any(words not in ('', 'godwitd has ended') and 'connecting' not in words for words in seen['trouble']):
        fail(f'{seen["trouble"]}')
    if not re.search(r'[1-9]\d* features', ' '.join(seen['picture'])):
        fail(f'no features: {seen["picture"]}')


def raw(port, request):
    with socket.create_connection(('127.0.0.1', port), timeout=20) as s:
        s.sendall(request)
        s.shutdown(socket.SHUT_WR) if request == b'' else None
        out = b''
        while True:
            try:
                block = s.recv(65536)
            except ConnectionResetError:
                return out
            if not block:
                return out
            out += block


def odd_requests(port):
    host = b'\r\nHost: localhost\r\n\r\n'
    for request, status in ((b'GET / HTTP/1.1' + host, b'200'), (b'HEAD / HTTP/1.1' + host, b'200'),
                            (b'POST / HTTP/1.1' + host, b'405'), (b'GET /../etc/passwd HTTP/1.1' + host, b'404'),
                            (b'GET /status?x=1 HTTP/1.1' + host, b'200'), (b'GET / HTTP/1.1\r\n\r\n', b'400'),
                            (b'\x16\x03\x01\r\n\r\n', b'400'), (b'GET / HTTP/1.1\r\nHost: evil.example\r\n\r\n', b'403'),
                            (b'GET /' + b'x' * 9000 + b' HTTP/1.1' + host, b'431')):
        answer = raw(port, request)
        if not answer.startswith(b'HTTP/1.1 ' + status):
            fail(f'{request[:60]}: {answer[:80]}')
        if request.startswith(b'HEAD') and not answer.endswith(b'\r\n\r\n'):
            fail('HEAD has a body')
    # Who says nothing holds nobody up.
    silent = [socket.create_connection(('127.0.0.1', port)) for _ in range(10)]
    if 'godwit' not in text_of(port, '/'):
        fail('the page is gone')
    for s in silent:
        s.close()


def main():
    with tempfile.TemporaryDirectory(prefix='godwit_view.') as name:
        folder = pathlib.Path(name)
        config = folder / 'godwit.toml'
        config.write_text('[camera]\nsource = "sim"\nscenario = "street"\npictures = 60\n[imu]\nsource = "none"\n'
                          f'[detector]\nenabled = false\n[live]\nsocket = "{folder}/live"\n')
        view = View('--config', config, '--port', 0)
        until('nobody there is not said',
              lambda: view.status().get('error') == f'{folder}/live: no godwitd serves it')
        taken = subprocess.run([GODWIT, 'view', '--port', str(view.port)], capture_output=True, text=True, check=False, timeout=60)
        if taken.returncode != 2 or 'is taken' not in taken.stderr:
            fail(f'a port that is taken: {taken}')
        nowhere = subprocess.run([GODWIT, 'view', '--address', 'here'], capture_output=True, text=True, check=False, timeout=60)
        if nowhere.returncode != 2 or 'is no address' not in nowhere.stderr:
            fail(f'no address: {nowhere}')
        odd_requests(view.port)
        daemon = Daemon(GODWITD, config)
        daemon.says('-> TRACKING')
        until('it does not find a godwitd that has come', lambda: view.status().get('state') == 'TRACKING')
        browse(view, folder)
        picture = json.loads(until('no picture', lambda: '"jpeg"' in text_of(view.port, '/picture') and text_of(view.port, '/picture')))
        if picture['picture']['width'] != 640 or len(picture['picture']['features']) < 30:
            fail(f'{picture["picture"]["features"]}')
        looked = subprocess.run([str(LOOK_ON), '--port', str(view.port), '--seconds', '2'], capture_output=True, text=True, check=False)
        if not re.match(r'looked \d+ times: 1 flights, [1-9]\d* pictures, [1-9]\d* tracks\n$', looked.stdout):
            fail(f'benchmarks/look_on does not look: {looked}')
        daemon.process.kill()
        daemon.process.wait()
        until('the end is not told', lambda: 'error' in view.status())
        if 'error' not in json.loads(text_of(view.port, '/picture')):
            fail('a picture of a flight that has ended is shown as if it were live')
        daemon = Daemon(GODWITD, config)
        until('one that has come back is not found', lambda: view.status().get('pid') == daemon.process.pid)
        daemon.end()
        view.end()
    print('view: ok')


main()
