"""The look into packages finds what it is there for: a package that is wrong in each way is told so, a right one passes."""
import pathlib
import subprocess
import sys
import tempfile

HERE = pathlib.Path(__file__).resolve().parent
CONTROL = '''Package: godwit
Version: 1-1
Architecture: {}
Maintainer: nobody <nobody@godwit.invalid>
Depends: {}
Description: a test
'''


def package(folder, architecture, depends, conffiles, program='/bin/true'):
    """A package of two programs, which are this machine's own, and a file in /etc."""
    root = folder / 'root'
    (root / 'DEBIAN').mkdir(parents=True)
    (root / 'usr/bin').mkdir(parents=True)
    (root / 'etc').mkdir()
    for name in ('godwit', 'godwitd'):
        (root / 'usr/bin' / name).write_bytes(pathlib.Path(program).read_bytes())
    (root / 'etc/godwit.toml').write_text('a = 1\n', encoding='utf-8')
    (root / 'DEBIAN/control').write_text(CONTROL.format(architecture, depends), encoding='utf-8')
    if conffiles:
        (root / 'DEBIAN/conffiles').write_text(''.join(name + '\n' for name in conffiles), encoding='utf-8')
    out = folder / 'godwit.deb'
    subprocess.run(['dpkg-deb', '--root-owner-group', '-b', root, out], check=True, capture_output=True)
    return out


def look(*what, **more):
    with tempfile.TemporaryDirectory(prefix='godwit_look.') as folder:
        done = subprocess.run([HERE / 'look_into.py', '--no-lintian', package(pathlib.Path(folder), *what, **more)],
                              capture_output=True, text=True)
        return done.returncode, done.stdout + done.stderr


def expect(condition, told):
    if not condition:
        sys.exit('FAILED: ' + told)


code, told = look('amd64', 'libc6', ['/etc/godwit.toml'])
expect(code == 0, told)
# Debian 12's own programs ask for its own glibc 2.34: too new for JetPack 5.
code, told = look('arm64', 'libc6', ['/etc/godwit.toml'])
expect(code == 1 and 'asks for GLIBC_2.34, allowed: (2, 31)' in told, told)
code, told = look('arm64', 'libgcc-s1', ['/etc/godwit.toml'])
expect(code == 1 and 'wants libc.so.6, which no package of Depends brings' in told, told)
code, told = look('amd64', 'libc6', [])
expect(code == 1 and '/etc/godwit.toml is no conffile' in told, told)
done = subprocess.run([HERE.parents[1] / 'toolchain/deb/depends', '/bin/ls'], capture_output=True, text=True)
expect(done.returncode != 0 and 'libselinux.so.1' in done.stderr, done.stdout + done.stderr)
print('four packages looked into')
