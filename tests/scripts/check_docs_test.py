#!/usr/bin/python3
"""scripts/check_docs: the repository's documents are in order, and what leads nowhere is found."""
import os
import subprocess
import sys
import tempfile

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
CHECK = os.path.join(ROOT, 'scripts/check_docs')


def run(*files):
    return subprocess.run([CHECK, *files], capture_output=True, text=True, check=False)


def main():
    whole = run()
    assert whole.returncode == 0, whole.stdout
    with tempfile.TemporaryDirectory() as folder:
        page = os.path.join(folder, 'page.md')
        open(os.path.join(folder, 'other.md'), 'w', encoding='utf-8').close()
        with open(page, 'w', encoding='utf-8') as f:
            f.write('[good](other.md) [bad](gone.md)\n`vo_core/tracker.h` `vo_core/tracker` `vo_core/gone.cpp`\n'
                    '`scripts/{demo,gone}` `build/release/x` `scripts/test full`\n')
        told = run(page)
        assert told.returncode == 1, told.stdout
        for expected in (':1: link to gone.md', ':2: `vo_core/gone.cpp`', ':3: `scripts/gone`'):
            assert expected in told.stdout, (expected, told.stdout)
        assert '3 findings' in told.stdout, told.stdout


if __name__ == '__main__':
    main()
    sys.exit(0)
