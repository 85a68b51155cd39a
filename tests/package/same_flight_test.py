"""The comparison of both processors' flights: what rounding does passes, what a worse program does is told."""
import pathlib
import random
import runpy
import sys

PARTS = runpy.run_path(str(pathlib.Path(__file__).resolve().parent / 'same_flight.py'))
chance, worse = PARTS['chance'], PARTS['worse']
# ATE [m] of amd64's release build (7a68090, the last ones perhaps 5f46717) over 300 pictures of the night, from its first to
# its fourteenth picture on.
NIGHT = [0.00608, 0.00780, 0.01107, 0.00751, 0.00739, 0.00860, 0.00713]
NIGHT_LATER = [0.00689, 0.01086, 0.00784, 0.00680, 0.00757, 0.01014, 0.00718]


def main():
    failed = []

    def check(good, what):
        if not good:
            failed.append(what)

    check(abs(chance([1, 2, 3], [4, 5, 6]) - 1 / 20) < 1e-12, 'three above three: one of the twenty orders')
    check(chance([4, 5, 6], [1, 2, 3]) == 1, 'three below three')
    check(chance([1, 1, 1], [1, 1, 1]) == 1, 'all alike')
    # Flight by flight these differ by up to four tenths of one another.
    check(not worse(NIGHT, NIGHT_LATER) and not worse(NIGHT_LATER, NIGHT), 'flights as amd64 itself flies them')
    check(worse(NIGHT, [1.6 * ate for ate in NIGHT_LATER]), 'all six tenths further off, among flights that differ by as much')
    alike = [0.0049 + 1e-5 * i for i in range(7)]
    check(worse(alike, [8 / 7 * ate for ate in alike]), 'a seventh, where flights are alike')
    check(not worse([0.0049] * 7, [0.0050] * 7), 'always further off, by less than a tenth')
    # How often chance alone is told: both from one distribution, as wide as the corridor's.
    draw = random.Random(1)
    told = sum(worse(*([draw.lognormvariate(0, 0.3) for _ in range(7)] for _ in range(2))) for _ in range(400))
    check(told <= 8, f'{told} of 400 pairs without a difference were told as one, where 2 are to be expected')
    for what in failed:
        print(f'FAILED: {what}')
    print(f'same_flight_test: {len(failed)} failed')
    return bool(failed)


if __name__ == '__main__':
    sys.exit(main())
