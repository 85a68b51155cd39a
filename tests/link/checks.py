"""What the link's Python tests share: checks that are told and counted, and cases to choose from."""
import sys

_failed = []


def check(condition, text):
    print(("ok    " if condition else "FAIL  ") + text, flush=True)
    if not condition:
        _failed.append(text)


def run_cases(cases, only=""):
    """Runs those of the cases (name: function) that `only` names, comma-separated, all where it is empty, and ends the
    program: with 1 if a check failed."""
    chosen = only.split(",") if only else list(cases)
    for name in chosen:
        if name not in cases:
            sys.exit("no case %s; there are %s" % (name, ", ".join(cases)))
        cases[name]()
    print("%d failed" % len(_failed))
    sys.exit(1 if _failed else 0)
