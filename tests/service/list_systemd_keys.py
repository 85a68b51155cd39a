#!/usr/bin/python3
"""Prints the keys of services that systemd VERSION knows, out of what a newer systemd's Debian package says of itself.

  list_systemd_keys.py VERSION OLDER > tests/service/systemd_VERSION_keys.txt

OLDER: /lib/systemd/systemd out of a package between VERSION and this machine's, for 245 that of Debian 11 (247):
apt-get download, dpkg-deb -x. All keys that this machine's systemd knows (systemd --dump-configuration-items), less those of which its NEWS
(/usr/share/doc/systemd/NEWS.gz) speaks under a later version and under none up to VERSION, and those that OLDER does not have: of some,
NEWS never speaks. That leaves out rather too many keys than too few; OLD brings back old ones of which NEWS speaks late.
"""
import gzip
import pathlib
import re
import subprocess
import sys

NEWS = '/usr/share/doc/systemd/NEWS.gz'
# In systemd's own list of all directives, test/fuzz/fuzz-unit-file/directives.service, as it was long before 245
# (systemd-stable, commit 78f9ad2e8c17).
OLD = set('''ConditionFirstBoot InaccessiblePaths MemoryHigh MemoryMax PropagatesReloadTo RequiredBy StartupCPUWeight
WantedBy'''.split())


def main():
    version = int(sys.argv[1])
    # Its table of keys: "Service.User" and the like, between zeros. Of [Install] it has another one.
    older = set(re.findall(rb'\0((?:Unit|Service)\.[A-Za-z0-9]+)(?=\0)', pathlib.Path(sys.argv[2]).read_bytes()))
    if b'Service.User' not in older:
        sys.exit(f'{sys.argv[2]} is no systemd')
    parts = re.split(r'^CHANGES WITH (\d+)[^\n]*:\n', gzip.open(NEWS, 'rt').read(), flags=re.M)
    told = {True: '', False: ''}
    for number, text in zip(parts[1::2], parts[2::2]):
        told[int(number) > version] += text
    if not told[True] or not told[False]:
        sys.exit(f'{NEWS} does not tell of versions before and after {version}')
    known = subprocess.run(['/lib/systemd/systemd', '--dump-configuration-items'], check=True, capture_output=True,
                           text=True).stdout
    print(f'# Keys of services that systemd {version} knows; made by tests/service/list_systemd_keys.py, which says how.')
    section = ''
    for line in known.splitlines():
        if line.startswith('['):
            section = line
            if section in ('[Unit]', '[Service]', '[Install]'):
                print(section)
        key = line.partition('=')[0]
        if section not in ('[Unit]', '[Service]', '[Install]') or not re.fullmatch(r'\w+', key) or '=' not in line:
            continue
        of_later, of_earlier = (re.search(rf'(?<!\w){key}=', told[later]) for later in (True, False))
        in_older = section == '[Install]' or f'{section[1:-1]}.{key}'.encode() in older
        if in_older and (not of_later or of_earlier or key in OLD):
            print(key)


main()
