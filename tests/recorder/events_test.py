"""Events as a user meets them: a flight that asks by SIGUSR1, a flight that is lost, and `godwit replay` of what was written.

  events_test.py GODWIT GODWITD
"""
import json
import pathlib
import signal
import subprocess
import sys
import tempfile
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent.parent))
from flying_daemon import PATIENCE_S, Daemon, fail  # noqa: E402

GODWIT, GODWITD = sys.argv[1:3]


def replay(event, *options):
    """Flies it with the configuration that it holds; the summary."""
    out = event.parent / (event.name + '.out')
    run = subprocess.run([GODWIT, 'replay', event, '--config', event / 'configuration.toml', '--out', out, *options],
                         capture_output=True, text=True, check=False)
    if run.returncode != 0:
        fail(f'replay of {event}: {run.stdout}{run.stderr}')
    return json.loads((out / 'summary.json').read_text())


def config_of(folder, more=''):
    config = folder / 'godwit.toml'
    config.write_text('[camera]\nsource = "sim"\nscenario = "street"\npictures = 60\n[imu]\nsource = "none"\n'
                      f'[detector]\nenabled = false\n[recorder]\nfolder = "{folder}/events"\nbefore_s = 3\nafter_s = 1\n' + more)
    return config


def asked_for(folder):
    daemon = Daemon(GODWITD, config_of(folder))
    daemon.says('-> TRACKING')
    time.sleep(3)
    daemon.process.send_signal(signal.SIGUSR1)
    daemon.says('event: request')
    daemon.end()
    if not any('events written, 0 not,' in line for line in daemon.said):
        fail(''.join(daemon.said))
    event, = (folder / 'events').glob('*-request')
    about = json.loads((event / 'event.json').read_text())
    if about['kind'] != 'request' or about['pictures'] < 60 or 'SIGUSR1' not in about['reason']:
        fail(f'{about}')
    if not about['t_first_ns'] < about['t_ns'] < about['t_last_ns']:
        fail(f'the event does not lie within its pictures: {about}')
    # The street flown forth and back: a new start finds a map in it.
    summary = replay(event, '--sequential')
    if summary['frames'] != about['pictures'] or summary['tracked'] < 20:
        fail(f'{summary}')
    print(f'asked for: {about["pictures"]} pictures, {summary["tracked"]} of them tracked in replay')
    if list((folder / 'events').glob('*.part')):
        fail('half a folder is left')


def killed(folder):
    """In the middle of an event: nothing that looks whole and is not, and the next flight clears it away."""
    config = config_of(folder, 'budget_mb = 1000\n')
    daemon = Daemon(GODWITD, config)
    daemon.says('-> TRACKING')
    time.sleep(1)
    daemon.process.send_signal(signal.SIGUSR1)
    until = time.monotonic() + PATIENCE_S
    while time.monotonic() < until and not list((folder / 'events').glob('*.part')):
        time.sleep(0.005)
    daemon.process.kill()
    daemon.process.wait()
    for event in (folder / 'events').glob('*'):
        if event.suffix != '.part' and not (event / 'event.json').exists():
            fail(f'{event} has a name and is not whole')
    daemon = Daemon(GODWITD, config)
    daemon.says('-> TRACKING')
    daemon.process.send_signal(signal.SIGUSR1)
    daemon.says('event: request')
    daemon.end()
    if list((folder / 'events').glob('*.part')):
        fail('what the killed one began is still there')


def record(folder, scenario, frames):
    """A simulated flight as a recording; its pictures."""
    subprocess.run([GODWIT, 'sim', scenario, '--frames', str(frames), '--out', folder / scenario], check=True,
                   stdout=subprocess.DEVNULL)
    return sorted((folder / scenario).rglob('*.jpg'))


def street_with_another_world(folder):
    """A street that is somewhere else for a second, behind a few pictures that cannot be read."""
    pictures, others = record(folder, 'street', 190), record(folder, 'corridor', 30)
    for picture in pictures[120:123]:
        picture.write_bytes(b'broken')
    for picture, other in zip(pictures[123:153], others):
        picture.write_bytes(other.read_bytes())
    return folder / 'street'


def lost(folder):
    """A recording that cannot be followed, flown with --events: a loss, and its event replayed. A folder that cannot be made is
    told, and the flight goes on to its end."""
    recording = street_with_another_world(folder)
    out = folder / 'out'
    flown = subprocess.run([GODWIT, 'replay', recording, '--out', out, '--events', folder / 'events'], capture_output=True,
                           text=True, check=False)
    if flown.returncode != 0:
        fail(flown.stderr)
    events = sorted((folder / 'events').iterdir())
    if not events or any(event.name.endswith('.part') for event in events):
        fail(f'{events}: {flown.stderr}')
    about = json.loads((events[0] / 'event.json').read_text())
    if about['kind'] not in ('loss', 'reset') or about['pictures_missing'] < 1 or not about['reason']:
        fail(f'{about}')
    summary = replay(events[0])
    if summary['tracked'] < 20:
        fail(f'{summary}')
    print(f'lost: {about["reason"]}; {summary["tracked"]} of {about["pictures"]} tracked in replay')
    flown = subprocess.run([GODWIT, 'replay', recording, '--out', out, '--events', '/proc/no/such'], capture_output=True, text=True,
                           check=False)
    if flown.returncode != 0 or '/proc/no/such: cannot be made' not in flown.stderr:
        fail(f'{flown.returncode}: {flown.stderr}')


def main():
    for case in (asked_for, killed, lost):
        with tempfile.TemporaryDirectory(prefix='godwit_events.') as folder:
            case(pathlib.Path(folder))


main()
