#!/usr/bin/python3
"""Looks into Debian packages: what their programs ask of the machine, what they would overwrite, and what lintian says.

  look_into.py [--no-lintian] PACKAGE.deb..

Fails where a shipped program or library
 - asks for a newer C library than that of the oldest system it is meant for (arm64: JetPack 5, glibc 2.31), or on arm64 for
   any version of libstdc++, which it is to bring along;
 - wants a library that is neither in the package nor in a package of its Depends;
 - is bound symbol by symbol in flight (no -z now);
where Depends has a name that Ubuntu 20.04 and Debian 12 do not both have, where a file under /etc is no conffile, where a file
that belongs into the package is not there, or where lintian finds an error.
"""
import pathlib
import re
import runpy
import subprocess
import sys
import tempfile

# Highest symbol versions: glibc 2.31 and systemd 245 are those of Ubuntu 20.04; amd64 is for Debian 12.
LIMITS = {'arm64': {'GLIBC': (2, 31), 'GCC': (10,), 'LIBSYSTEMD': (245,)},
          'amd64': {'GLIBC': (2, 36), 'GLIBCXX': (3, 4, 30), 'CXXABI': (1, 3, 13), 'GCC': (12,), 'LIBSYSTEMD': (252,)}}
# What each of the packages must hold.
CONTENT = {
    'godwit': [
        '/etc/godwit/godwit.toml', '/usr/bin/godwit', '/usr/bin/godwitd', '/usr/lib/systemd/system/godwitd.service',
        '/usr/lib/systemd/network/80-godwit-can0.network', '/usr/lib/sysusers.d/godwit.conf', '/usr/lib/udev/rules.d/80-godwit.rules',
        '/usr/share/bash-completion/completions/godwit', '/usr/share/doc/godwit/changelog.Debian.gz',
        '/usr/share/doc/godwit/copyright', '/usr/share/doc/godwit/devices.md', '/usr/share/doc/godwit/godwit.spdx.json', '/usr/share/godwit/godwit.dbc',
        '/usr/share/godwit/plotjuggler.xml', '/usr/share/godwit/scenarios/street.toml',
        '/usr/share/man/man1/godwit.1.gz', '/usr/share/man/man8/godwitd.8.gz'],
    'godwit-tools': [
        '/usr/share/doc/godwit-tools/copyright', '/usr/share/godwit/tools/evaluate', '/usr/share/godwit/tools/from_kitti',
        '/usr/share/godwit/tools/from_video', '/usr/share/godwit/tools/godwit-report', '/usr/share/godwit/tools/report/page.py'],
    'godwit-models': [
        '/usr/share/doc/godwit-models/copyright', '/usr/share/godwit/models/README.md',
        '/usr/share/godwit/models/cbam_yolov5n_320.onnx', '/usr/share/godwit/models/cbam_yolov5n_320.toml',
        '/usr/share/godwit/models/cbam_yolov5n_416.onnx', '/usr/share/godwit/models/cbam_yolov5n_416.toml',
        '/usr/share/godwit/models/cbam_yolov5n_480x352.onnx', '/usr/share/godwit/models/cbam_yolov5n_480x352.toml',
        '/usr/share/godwit/models/cbam_yolox_nano_416.onnx', '/usr/share/godwit/models/cbam_yolox_nano_416.toml',
        '/usr/share/godwit/models/yolox_nano_320.onnx', '/usr/share/godwit/models/yolox_nano_320.toml',
        '/usr/share/godwit/models/yolox_nano_416.onnx', '/usr/share/godwit/models/yolox_nano_416.toml',
        '/usr/share/godwit/models/LICENSE', '/usr/share/godwit/models/LICENSE-YOLOX'],
}
# What the tools want: Ubuntu 20.04 and Debian 12 call these so.
PYTHON = {'python3', 'python3-matplotlib', 'python3-numpy', 'python3-opencv', 'python3-pil', 'python3-yaml'}
DEPENDS = pathlib.Path(__file__).resolve().parents[2] / 'toolchain/deb/depends'
KNOWN = runpy.run_path(str(DEPENDS))
# On arm64: the package that brings a library.
BRINGS = {library: package for library, (package, _) in KNOWN['BRINGS'].items()}


def said(*command):
    return subprocess.run([str(word) for word in command], check=True, capture_output=True, text=True).stdout


def field(package, name):
    return said('dpkg-deb', '-f', package, name).strip()


def highest(program):
    """{'GLIBC': (2, 30), ..}: of the versions that the program asks for."""
    found = {}
    for family, version in re.findall(r'Name: ([A-Z]+)_(\d[\d.]*)', said('readelf', '-W', '-V', program)):
        found[family] = max(found.get(family, ()), tuple(int(part) for part in version.split('.')))
    return found


def look_at_program(program, name, architecture, depends, failures):
    dynamic = said('readelf', '-W', '-d', program)
    wanted = re.findall(r'NEEDED.*\[(.*)\]', dynamic)
    asked = highest(program)
    for family, version in asked.items():
        limit = LIMITS[architecture].get(family)
        if limit is None or version > limit:
            failures.append(f'{name} asks for {family}_{".".join(map(str, version))}, allowed: {limit}')
    if re.search(r'(RPATH|RUNPATH).*\[(?!/usr/lib/godwit\])', dynamic):
        failures.append(f'{name} looks for libraries in a folder of its own')
    if not re.search(r'\(FLAGS_1\).*\bNOW\b', dynamic):
        failures.append(f'{name} binds its symbols in flight: link it with -z now')
    if architecture == 'arm64':
        for library in wanted:
            if BRINGS.get(library) not in depends:
                failures.append(f'{name} wants {library}, which no package of Depends brings')
    print(f'  {name}: ' + ' '.join(f'{family}_{".".join(map(str, v))}' for family, v in sorted(asked.items())) +
          f'; wants {" ".join(wanted)}')


def look_into(package, failures):
    architecture = field(package, 'Architecture')
    depends = {item.strip().split(' ')[0] for item in field(package, 'Depends').split(',')} - {''}
    for name in sorted(depends - KNOWN['NAMES'] - PYTHON):
        failures.append(f'depends on {name}, a name that Ubuntu 20.04 and Debian 12 do not both have: link it statically')
    print(f'{package.name} ({package.stat().st_size / 1e6:.1f} MB), Depends: {field(package, "Depends")}')
    with tempfile.TemporaryDirectory(prefix='godwit_package.') as folder:
        root = pathlib.Path(folder) / 'root'
        said('dpkg-deb', '-x', package, root)
        said('dpkg-deb', '-e', package, pathlib.Path(folder) / 'control')
        conffiles = pathlib.Path(folder) / 'control/conffiles'
        kept = conffiles.read_text(encoding='utf-8').split() if conffiles.exists() else []
        programs = 0
        for path in sorted(root.rglob('*')):
            if path.is_symlink() or not path.is_file():
                continue
            name = '/' + str(path.relative_to(root))
            if name.startswith('/etc/') and name not in kept:
                failures.append(f'{name} is no conffile')
            with open(path, 'rb') as file:
                if file.read(4) == b'\x7fELF':
                    programs += 1
                    look_at_program(path, name, architecture, depends, failures)
        missing = [name for name in kept if not (root / name[1:]).is_file()]
        if missing:
            failures.append(f'conffiles that are not there: {missing}')
        for name in CONTENT[field(package, 'Package')]:
            if not (root / name[1:]).is_file():
                failures.append(f'{name} is not in {package.name}')
        if architecture != 'all' and programs < 2:
            failures.append(f'{package.name} has {programs} programs')


def main(arguments):
    lintian = '--no-lintian' not in arguments
    packages = [pathlib.Path(word) for word in arguments if word != '--no-lintian']
    if not packages:
        sys.exit(__doc__)
    failures = []
    for package in packages:
        look_into(package, failures)
    if lintian:
        done = subprocess.run(['lintian', '--fail-on', 'error', '--display-level', 'error', *map(str, packages)],
                              capture_output=True, text=True)
        if done.returncode != 0:
            failures.append('lintian: ' + done.stdout + done.stderr)
    for failure in failures:
        print('FAILED: ' + failure)
    return 1 if failures else 0


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
