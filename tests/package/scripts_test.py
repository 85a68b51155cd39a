"""What dpkg runs (toolchain/deb): processors that the package is not for are refused in words; purging leaves the operator's logs."""
import pathlib
import subprocess
import sys
import tempfile

DEB = pathlib.Path(__file__).resolve().parents[2] / 'toolchain/deb'
HASWELL = 'fpu sse4_2 movbe popcnt xsave avx f16c lahf_lm abm fma bmi1 avx2 bmi2'
XAVIER = 'fp asimd evtstrm aes pmull sha1 sha2 crc32 atomics fphp asimdhp cpuid'


def expect(condition, told):
    if not condition:
        sys.exit('FAILED: ' + told)


def run(script, action, folder, **paths):
    """The script as it is, but for the paths that it looks at: these lie in `folder`."""
    text = (DEB / script).read_text(encoding='utf-8')
    for path, name in paths.items():
        expect(name in text, f'{script} does not name {name}')
        text = text.replace(name, str(folder / path))
    done = subprocess.run(['sh', '-s', action], input=text, capture_output=True, text=True)
    return done.returncode, done.stdout + done.stderr


def refuses(script, head, features, without):
    with tempfile.TemporaryDirectory(prefix='godwit_scripts.') as made:
        folder = pathlib.Path(made)
        for missing in [None, *without]:
            there = ' '.join(f for f in features.split() if f != missing)
            (folder / 'cpuinfo').write_text(f'processor : 0\n{head}\t: {there}\n\nprocessor : 1\n{head}\t: {there}\n', encoding='utf-8')
            for action in ('install', 'upgrade', 'abort-upgrade'):
                code, told = run(script, action, folder, cpuinfo='/proc/cpuinfo')
                wrong = missing is not None and action != 'abort-upgrade'
                expect(code == (1 if wrong else 0), f'{script} {action} without {missing}: {code} {told}')
                expect(not wrong or missing in told and 'lacks' in told, told)
        (folder / 'cpuinfo').unlink()
        code, told = run(script, 'install', folder, cpuinfo='/proc/cpuinfo')
        expect(code == 0, f'{script} where nothing is known of the processor: {told}')


def purge_leaves_logs():
    with tempfile.TemporaryDirectory(prefix='godwit_scripts.') as made:
        state = pathlib.Path(made) / 'state'
        own = ['lock', 'link_parameters.txt', 'link_parameters.txt.part', 'link_reset_counter.txt']
        operators = ['flights/000001.ulg', 'events/000001-loss/event.json', 'notes.txt']
        for name in own + operators:
            (state / name).parent.mkdir(parents=True, exist_ok=True)
            (state / name).write_text('x', encoding='utf-8')

        def postrm(action):
            code, told = run('postrm', action, pathlib.Path(made), state='/var/lib/godwit', etc='/etc/godwit', systemd='/run/systemd/system')
            expect(code == 0 and not told, f'postrm {action}: {code} {told}')

        postrm('remove')
        expect(all((state / name).exists() for name in own + operators), 'removing takes what the daemon saved')
        postrm('purge')
        expect(not any((state / name).exists() for name in own), 'purging leaves what the daemon saved for itself')
        expect(all((state / name).exists() for name in operators), 'purging takes what is the operator\'s')
        for name in operators:
            (state / name).unlink()
        (state / 'events/000001-loss').rmdir()
        postrm('purge')
        expect(not state.exists(), 'purging leaves empty folders')


refuses('preinst_amd64', 'flags', HASWELL, ('avx', 'avx2', 'bmi1', 'bmi2', 'f16c', 'fma', 'abm', 'movbe', 'xsave'))
refuses('preinst_jetson', 'Features', XAVIER, ('asimdhp',))
purge_leaves_logs()
print('processors refused, logs left')
