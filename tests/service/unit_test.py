"""The unit is one that systemd takes without a word, that an old systemd knows, and that leaves little open.

  unit_test.py UNIT GODWITD KEYS
"""
import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile

UNIT, GODWITD, KEYS = map(pathlib.Path, sys.argv[1:4])
MOST_EXPOSED = 3.0


def fail(reason):
    sys.exit('FAILED: ' + reason)


def analyze(*arguments):
    return subprocess.run(['systemd-analyze', *arguments], capture_output=True, text=True, check=False,
                          env={**os.environ, 'SYSTEMD_COLORS': '0', 'SYSTEMD_PAGER': ''})


def silent(unit):
    """systemd-analyze ends well on an unknown key: what counts is that it says nothing."""
    said = analyze('verify', '--man=no', str(unit))
    return said.returncode == 0 and not said.stderr.strip(), said.stderr


def keys_of(text):
    """(section, key) of each line that sets one; of a list of keys as well."""
    section, found = '', []
    for line in text.splitlines():
        if re.fullmatch(r'\[\w+\]', line):
            section = line
        elif match := re.match(r'([A-Za-z]+)(=|$)', line):
            found.append((section, match.group(1)))
    return found


def main():
    if shutil.which('systemd-analyze') is None:
        print('SKIPPED: systemd-analyze is not there')
        sys.exit(1 if os.environ.get('CI') == 'true' else 77)
    known = set(keys_of(KEYS.read_text()))
    text = UNIT.read_text()
    used = set(keys_of(text))
    if used - known:
        fail(f'systemd 245 does not know {sorted(used - known)}')
    # ProtectClock came with 245, ProtectProc with 247, ExitType with 250.
    if ('[Service]', 'ProtectClock') not in known or {('[Service]', 'ProtectProc'), ('[Service]', 'ExitType')} & known:
        fail(f'{KEYS.name} is not the list of systemd 245')
    if len(used) < 40:
        fail(f'only {len(used)} keys found: is this the unit?')
    with tempfile.TemporaryDirectory(prefix='godwit_unit.') as folder:
        # The program need not be installed where the unit will look for it.
        unit = pathlib.Path(folder) / 'godwitd.service'
        unit.write_text(re.sub(r'^ExecStart=\S+', f'ExecStart={GODWITD.resolve()}', text, flags=re.M))
        good, said = silent(unit)
        if not good:
            fail(f'systemd-analyze verify: {said}')
        broken = pathlib.Path(folder) / 'broken.service'
        broken.write_text(unit.read_text() + '\n[Service]\nRestrat=always\n')
        if silent(broken)[0]:
            fail('a misspelt key is not noticed: this test proves nothing')
        told = analyze('security', '--offline=yes', str(unit)).stdout
        level = re.search(r'exposure level for .*: ([0-9.]+)', told)
        if level is None or float(level.group(1)) >= MOST_EXPOSED:
            fail(f'exposure: {level.group(0) if level else told}')
        print(f'{len(used)} keys; exposure {level.group(1)}')


main()
