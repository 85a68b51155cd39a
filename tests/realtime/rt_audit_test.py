"""toolchain/rt_audit on the real archives, and on one with deliberate offences: rt_audit_test.py TOOLCHAIN LIST ARCHIVE.."""
import pathlib
import subprocess
import sys
import tempfile

AUDIT = pathlib.Path(sys.argv[1]) / 'rt_audit'
LIST = pathlib.Path(sys.argv[1]) / sys.argv[2]
OFFENDER = '''
#include <cmath>
#include <cstring>
#include <mutex>
#include <string>
#include <sys/socket.h>
#include <vector>
int* leak() { return new int(3); }
void lock(std::mutex& m) { m.lock(); }
void text(std::string& s) { s.append("x"); }
void grow(std::vector<int>& v) { v.push_back(1); }
int innocent(int a) { return a + 1; }
double harmless(double a, double* to, const double* from, int n) { std::memcpy(to, from, n); return std::sin(a) + std::pow(a, 3.1); }
long waits(int socket, char* into) { return recv(socket, into, 1, 0); }
int elsewhere(int a);
int follows(int a) { return elsewhere(a) + 1; }
namespace { __attribute__((noinline)) int* deep(int a) { return a > 3 ? new int(a) : nullptr; } }
__attribute__((noinline)) int* middle(int a) { return deep(a + 1); }
int* thread_body(int a) { return middle(a) + 1; }
'''


def audit(*arguments):
    done = subprocess.run([AUDIT, *arguments], capture_output=True, text=True)
    return done.returncode, done.stdout


def main():
    code, said = audit(LIST, *sys.argv[3:])
    print(said)
    assert code == 0, f'the archives call what no line of {LIST.name} explains, or a line explains nothing'

    with tempfile.TemporaryDirectory() as folder:
        root = pathlib.Path(folder)
        (root / 'offender.cpp').write_text(OFFENDER)
        subprocess.run(['c++', '-O2', '-fPIC', '-c', 'offender.cpp'], cwd=root, check=True)
        subprocess.run(['ar', 'rc', 'offender.a', 'offender.o'], cwd=root, check=True)
        (root / 'list.txt').write_text('# nothing is allowed\n')
        code, said = audit(root / 'list.txt', root / 'offender.a')
        assert code == 1, said
        for offence in ('leak() calls operator new', 'lock(std::mutex&) calls pthread_mutex_lock', 'text(', 'grow('):
            assert offence in said, f'{offence} not found in: {said}'
        # Whatever lies outside and is not known to be harmless; also what of ours was not given.
        for offence in ('waits(int, char*) calls recv', 'follows(int) calls elsewhere(int)'):
            assert offence in said, f'{offence} not found in: {said}'
        assert 'innocent' not in said and 'harmless' not in said, said

        (root / 'list.txt').write_text('.* | .* | all of it\ngone\\(\\) | malloc | was there once\n')
        code, said = audit(root / 'list.txt', root / 'offender.a')
        assert code == 1 and 'list.txt:2: explains a call that is not there' in said, said
        (root / 'list.txt').write_text('.* | .* | all of it\n')
        assert audit(root / 'list.txt', root / 'offender.a')[0] == 0

        # From where a thread enters: what it reaches, and only that.
        (root / 'list.txt').write_text('FROM thread_body\\(.* | some thread\n')
        code, said = audit(root / 'list.txt', root / 'offender.a')
        assert code == 1 and 'deep(int) calls operator new' in said and 'leak()' not in said, said
        (root / 'list.txt').write_text('FROM innocent\\(.* | some thread\n')
        assert audit(root / 'list.txt', root / 'offender.a')[0] == 0
        (root / 'list.txt').write_text('FROM innocent\\(.* | some thread\nFROM gone\\(.* | some thread\n')
        code, said = audit(root / 'list.txt', root / 'offender.a')
        assert code == 1 and 'list.txt:2: no such function' in said, said


main()
