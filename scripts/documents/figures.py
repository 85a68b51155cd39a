"""Figures that a document shows: in a section with a table of measurements stands the command that makes it.

A section counts from one heading of the first or second order to the next; a command in the page's first one serves all of them.
A measurement is a decimal fraction in a row of a table. Not looked at: pages whose fractions are limits or numbers of
sections, and what says <!-- limits --> or "no command here".
"""
import re

NOT_MEASURED = {'architecture.md', 'algorithm.md', 'configuration.md', 'glossary.md', 'hazards.md', 'troubleshooting.md', 'CHANGELOG.md'}
SECTION = re.compile(r'(?m)^(?=#{1,2} )')
MEASURED = re.compile(r'(?m)^\|.*(?<![\w.-])\d+\.\d+(?![\w.])')
COMMAND = re.compile(r'(?m)^    \S|`(?:\w+=\S+ )?(?:\./)?(?:(?:build|scripts|benchmarks|tests|toolchain|detector|docs/pictures)/|ctest|godwit|\w+\.py)[^`]*`|no command here|<!-- limits -->')


def wrong_figures(name, text):
    """(line, what) of each section that shows measurements and no command."""
    if name in NOT_MEASURED:
        return
    line, first = 1, None
    for section in SECTION.split(text):
        head = section.partition('\n')[0]
        if head.startswith('# ') or first is None:
            first = section
        if MEASURED.search(section) and not COMMAND.search(section) and not COMMAND.search(first):
            yield line, f'"{head.strip("# ")}" shows figures and no command that makes them'
        line += section.count('\n')
