"""What the tests of accuracy share: a sequence, a run of the tool over it, and the error of what came out."""
import json
import os
import pathlib
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parents[2]


def find_sequence(name):
    """The sequence's folder. Where it is not there the test ends: status 77, skipped; a failure where CI=true."""
    shared = pathlib.Path(os.environ.get("GODWIT_SHARED_DIR", ROOT.parent / "shared"))
    sequence = shared / "data" / name
    if (sequence / "rgb.txt").exists():
        return sequence
    print(f"skipped: there is no {sequence}")
    sys.exit(1 if os.environ.get("CI") == "true" else 77)


def replay(godwit, sequence, out, *options):
    """summary.json of a run into the folder `out`."""
    subprocess.run([godwit, "replay", str(sequence), "--out", str(out), *options], check=True,
                   stdout=subprocess.DEVNULL)
    return json.loads((out / "summary.json").read_text())


def ate_m(sequence, out):
    """Error of the positions after Sim(3) against the sequence's ground truth."""
    said = subprocess.run([sys.executable, str(ROOT / "scripts" / "evaluate"), str(sequence / "groundtruth.txt"),
                           str(out), "--json"], check=True, capture_output=True, text=True).stdout
    return json.loads(said)["ate_m"]
