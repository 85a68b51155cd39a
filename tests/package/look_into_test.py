"""The look into packages finds what it is there for: a package that is wrong in each way is told so, a right one passes."""
import pathlib
import runpy
import subprocess
import sys
import tempfile

HERE = pathlib.Path(__file__).resolve().parent
CONTENT = runpy.run_path(str(HERE / 'look_into.py'))['CONTENT']
CONFFILE = '/etc/godwit/godwit.toml'
CONTROL = '''Package: godwit
Version: 1-1
Architecture: {}
Maintainer: nobody <nobody@godwit.invalid>
Depends: {}
Description: a test
'''


def compiled(folder, *words, text='int main() { return 0; }'):
    """A program for this machine."""
    out = folder / 'program'
    subprocess.run(['gcc', '-x', 'c', '-', '-o', out, *words], check=True, text=True, input=text)
    return out


def package(folder, architecture, depends, conffiles, program=None, without=None):
    """A package with all that belongs into it but `without`; its two programs are made here, or `program`."""
    program = program or compiled(folder, '-Wl,-z,now')
    root = folder / 'root'
    (root / 'DEBIAN').mkdir(parents=True)
    for name in CONTENT['godwit']:
        if name == without:
            continue
        file = root / name[1:]
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(pathlib.Path(program).read_bytes() if name.startswith('/usr/bin/') else b'a = 1\n')
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


code, told = look('amd64', 'libc6', [CONFFILE])
expect(code == 0, told)
# Programs of Debian 12 ask for its own glibc 2.34: too new for JetPack 5.
code, told = look('arm64', 'libc6', [CONFFILE])
expect(code == 1 and 'asks for GLIBC_2.34, allowed: (2, 31)' in told, told)
# godwitd asks systemd's library for the machine's number.
with tempfile.TemporaryDirectory(prefix='godwit_look.') as made:
    asks = compiled(pathlib.Path(made), '-Wl,-z,now', '-lsystemd',
                    text='int sd_id128_get_machine_app_specific(); int main() { return sd_id128_get_machine_app_specific(); }')
    code, told = look('amd64', 'libc6, libsystemd0', [CONFFILE], program=asks)
    expect(code == 0 and ' LIBSYSTEMD_233;' in told, told)
with tempfile.TemporaryDirectory(prefix='godwit_look.') as made:
    code, told = look('amd64', 'libc6', [CONFFILE], program=compiled(pathlib.Path(made), '-Wl,-z,lazy'))
    expect(code == 1 and '/usr/bin/godwit binds its symbols in flight' in told, told)
code, told = look('arm64', 'libgcc-s1', [CONFFILE])
expect(code == 1 and 'wants libc.so.6, which no package of Depends brings' in told, told)
code, told = look('amd64', 'libc6', [])
expect(code == 1 and CONFFILE + ' is no conffile' in told, told)
code, told = look('amd64', 'libc6, libjpeg62-turbo (>= 1.3.1)', [CONFFILE])
expect(code == 1 and 'depends on libjpeg62-turbo, a name that Ubuntu 20.04' in told, told)
unit = '/usr/lib/systemd/system/godwitd.service'
code, told = look('amd64', 'libc6', [CONFFILE], without=unit)
expect(code == 1 and unit + ' is not in godwit.deb' in told, told)
done = subprocess.run([HERE.parents[1] / 'toolchain/deb/depends', '/bin/ls'], capture_output=True, text=True)
expect(done.returncode != 0 and 'libselinux.so.1' in done.stderr, done.stdout + done.stderr)
print('eight packages looked into')
