"""A flight at real pace, with all its threads, flown again by its log: the same poses to the bit. And what is said of logs
that have a gap, and of pictures that are not those of the log.

  as_flown_test.py GODWIT
"""
import pathlib
import subprocess
import sys
import tempfile

GODWIT = sys.argv[1]
FRAMES = 150
FLIGHT = ['fly', 'street', '--frames', str(FRAMES)]


def fail(text):
    sys.exit(f'as_flown_test: {text}')


def godwit(code, *arguments):
    run = subprocess.run([GODWIT, *arguments], capture_output=True, text=True, check=False)
    if run.returncode != code:
        fail(f'{arguments}: exit code {run.returncode}, not {code}\n{run.stdout}{run.stderr}')
    return run.stdout + run.stderr


def says(text, *words):
    for word in words:
        if word not in text:
            fail(f'"{word}" is not in: {text}')


def poses(out):
    return (out / 'pose.csv').read_bytes()


def again(folder, name, *options, flight=(*FLIGHT, '--render-ahead')):
    """A flight at real pace, and the same once more; how often a box was used, and the log."""
    first, second, log = folder / name, folder / (name + '.again'), folder / (name + '.log')
    godwit(0, *flight, '--pace', 'real', '--log', log, '--out', first, *options)
    said = godwit(0, *[w for w in flight if w != '--render-ahead'], '--as-flown', log / '000001.ulg', '--out', second, *options)
    count = poses(first).count(b'\n') - 1
    says(said, f'as flown: all {count} poses of the log are the same to the bit')
    if count < 20:
        fail(f'{name}: only {count} poses')
    if poses(first) != poses(second):
        fail(f'{name}: pose.csv is not the same')
    print(f'{name}: {count} poses, equal to the bit')
    return log / '000001.ulg'


def main():
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        log = again(folder, 'masks', '--truth-masks', '--gate', 'on')
        seen = again(folder, 'detector', '--detector', 'on', '--imu', 'on')
        godwit(0, 'sim', 'street', '--frames', str(FRAMES), '--out', folder / 'recorded')
        again(folder, 'recording', '--imu', 'on', flight=('replay', folder / 'recorded'))

        out = folder / 'out'
        # What is missing of the flight.
        masks = ('--truth-masks', '--gate', 'on', '--out', out)
        says(godwit(1, *FLIGHT, '--as-flown', seen, '--imu', 'on', '--out', out), 'there was a detector in that flight')
        says(godwit(1, *FLIGHT, '--as-flown', seen, '--detector', 'on', '--out', out), 'there was an inertial sensor in that flight')
        says(godwit(1, 'fly', 'street', '--frames', str(FRAMES // 2), '--start', '9', '--as-flown', log, *masks),
             'these are not the pictures of that flight')
        says(godwit(1, *FLIGHT, '--seed', '77', '--as-flown', log, *masks), 'are not those of the log to the bit')

        # A log that ends early: refused, and what is whole is flown on request.
        whole = log.read_bytes()
        short = folder / 'short.ulg'
        short.write_bytes(whole[:len(whole) * 2 // 3])
        said = godwit(2, *FLIGHT, '--as-flown', short, *masks)
        says(said, 'was not recorded whole: the file breaks off within a message', '; --frames ')
        most = said.split('; --frames ')[1].split()[0]
        says(godwit(2, 'fly', 'street', '--frames', str(int(most) + 1), '--as-flown', short, *masks), 'not recorded whole')
        says(godwit(0, 'fly', 'street', '--frames', most, '--as-flown', short, *masks), 'are the same to the bit')
        if not (folder / 'masks' / 'pose.csv').read_bytes().startswith(poses(out)):
            fail('what is whole of a log is not the beginning of its flight')
        # One with a hole in it.
        middle = whole.index(b'\x00D', len(whole) // 2)
        short.write_bytes(whole[:middle] + whole[middle + 1000:])
        says(godwit(2, *FLIGHT, '--as-flown', short, *masks), 'not recorded whole')
        short.write_bytes(b'nothing of the kind, but long enough')
        says(godwit(2, *FLIGHT, '--as-flown', short, *masks), 'is no ULog file')
        for option in (['--sequential'], ['--pace', 'real'], ['--events', folder / 'events']):
            says(godwit(2, *FLIGHT, '--as-flown', log, *masks, *option), '--as-flown: the log says what came when')
        says(godwit(2, *FLIGHT, '--as-flown', log, *masks, '--imu', 'on', '--aids', 'range'),
             'the log does not hold when which of them was heard')
        says(godwit(2, *FLIGHT, '--aids', 'range', '--out', out), '--aids: without --imu on the vertical is missing')
        says(godwit(2, *FLIGHT, '--imu', 'on', '--aids', 'gps', '--out', out), 'one or more of range, baro, gnss')


main()
