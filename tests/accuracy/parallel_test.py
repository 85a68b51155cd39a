#!/usr/bin/env python3
"""The same sequence with all stages in threads, and in one: the accuracy must be the same within a fifth.

  parallel_test.py GODWIT SEQUENCE_NAME

Threads run differently each time, so the median of three runs counts. Exit status 77: the sequence is not there (a failure
where CI=true).
"""
import pathlib
import statistics
import sys
import tempfile

from replay_runs import ate_m, find_sequence, replay


def main():
    godwit, name = sys.argv[1], sys.argv[2]
    sequence = find_sequence(name)

    def ate(out, *options):
        summary = replay(godwit, sequence, out, *options)
        assert summary["tracked_share_after_first_pose"] > 0.99 and summary["maps"] == 1, summary
        return ate_m(sequence, out)

    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        one = ate(folder / "one", "--sequential")
        threads = [ate(folder / f"threads{i}") for i in range(3)]
    print(f"{name}: ATE {one:.4f} m sequential, {', '.join(f'{a:.4f}' for a in threads)} m in threads")
    return 0 if statistics.median(threads) <= 1.2 * one else 1


if __name__ == "__main__":
    sys.exit(main())
