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


# What the daemon and whoever flies it count on.
PROMISED = {
    'Type': 'notify', 'NotifyAccess': 'main', 'Restart': 'on-failure', 'RestartForceExitStatus': '75', 'RestartPreventExitStatus': '2',
    'TimeoutStopSec': '5', 'StartLimitIntervalSec': '0', 'StateDirectory': 'godwit', 'LimitRTPRIO': '98', 'LimitMEMLOCK': 'infinity',
    'OOMScoreAdjust': '-900', 'User': 'godwit', 'WatchdogSec': '2', 'SupplementaryGroups': 'video dialout', 'ReadWritePaths': '/sys/devices',
}


def main():
    if shutil.which('systemd-analyze') is None:
        print('SKIPPED: systemd-analyze is not there')
        sys.exit(1 if os.environ.get('CI') == 'true' else 77)
    known = set(keys_of(KEYS.read_text()))
    text = UNIT.read_text()
    used = set(keys_of(text))
    if used - known:
        fail(f'systemd 245 does not know {sorted(used - known)}')
    # ProtectClock came with 245, ProtectProc with 247, OnSuccessJobMode with 249, ExitType and ConditionCPUPressure with 250.
    later = {('[Service]', 'ProtectProc'), ('[Service]', 'ExitType'), ('[Unit]', 'OnSuccessJobMode'), ('[Unit]', 'ConditionCPUPressure')}
    if ('[Service]', 'ProtectClock') not in known or later & known:
        fail(f'{KEYS.name} is not the list of systemd 245')
    if len(used) < 40:
        fail(f'only {len(used)} keys found: is this the unit?')
    values = dict(re.findall(r'^(\w+)=(.*)$', text, re.M))
    for key, value in PROMISED.items():
        if values.get(key) != value:
            fail(f'{key}={values.get(key)} instead of {value}')
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
