#!/usr/bin/env python3
"""Annotated pictures of godwit's simulator: of scenarios made to learn from, or of those that fly, to be scored on.

  render.py --godwit build/release/firmware_app/godwit --out DIR --seeds 101 102            # to train on
  render.py --godwit build/release/firmware_app/godwit --out DIR --seeds 901 902 --to-score

Writes DIR/images, labels and ignore as data.load() reads a set, and DIR/purpose.json, by which train.py refuses what is to be
scored. To learn from: the scenarios in scenarios/ beside this program. To score: street, night, hover-in-crowd and
half-the-picture-moving of config/scenarios, a picture a second. A thing counts where enough of it is visible, by how much of
its box its visible pixels fill; of what is hidden more than that, the box is left out of learning and scoring.
"""
from __future__ import annotations

import argparse
import csv
import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import cv2

HERE = Path(__file__).resolve().parent
# Never trained on, whatever the seed: what flies in the tests and tables of the project.
FLOWN = ("street", "night", "hover-in-crowd", "half-the-picture-moving")
CLASS_OF = {"person": 0, "car": 2, "truck": 5}
# Share of its box that a thing must show. Whole, a person fills 0.35 to 0.6 of it and a vehicle 0.5 to 0.95 (between the
# quartiles of the four scenarios above, longer side from 16 pixels on): half of that.
ENOUGH = {"person": 0.25, "car": 0.3, "truck": 0.3}
PICTURES_PER_S = 1


def scenarios_of(flown: bool, names: list[str] | None = None) -> list[Path]:
    if names:
        found = {p.stem: p for p in scenarios_of(flown)}
        if unknown := [n for n in names if n not in found]:
            raise ValueError(f"no scenario {unknown[0]}; there are {', '.join(found)}")
        return [found[n] for n in names]
    if flown:
        return [HERE.parents[1] / "config" / "scenarios" / f"{name}.toml" for name in FLOWN]
    return sorted((HERE / "scenarios").glob("*.toml"))


def at_one_a_second(scenario: str) -> str:
    """The scenario with so few pictures a second: what follows at once shows the same."""
    text, count = re.subn(r"(?m)^fps = [0-9.]+", f"fps = {PICTURES_PER_S}", scenario)
    if count != 1:
        raise ValueError("a scenario must have one line fps = NUMBER")
    return text


def sort_boxes(rows: list[dict], width: int, height: int) -> tuple[list[str], list[str]]:
    """The lines of the label file and of the one of what is left out, from rows of boxes.csv of one picture."""
    learnt, left_out = [], []
    for row in rows:
        x0, y0, x1, y1 = (float(row[k]) for k in ("x0", "y0", "x1", "y1"))
        area = (x1 - x0) * (y1 - y0)
        if area <= 0:
            continue
        place = f"{(x0 + x1) / 2 / width:.6f} {(y0 + y1) / 2 / height:.6f} {(x1 - x0) / width:.6f} {(y1 - y0) / height:.6f}"
        enough = int(row["visible_px"]) >= ENOUGH[row["kind"]] * area
        (learnt if enough else left_out).append(f"{CLASS_OF[row['kind']]} {place}")
    return learnt, left_out


def take(flight: Path, name: str, width: int, height: int, out: Path, every: int = 1, quality: int | None = None) -> int:
    """Copies the pictures of a folder that godwit sim wrote, each `every`th from the first on, as they are or written again as
    JPEG of `quality`; returns how many."""
    boxes: dict[int, list[dict]] = {}
    with open(flight / "boxes.csv", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            boxes.setdefault(int(row["t"].replace(".", "")), []).append(row)
    pictures = sorted((flight / "mav0" / "cam0" / "data").glob("*.jpg"), key=lambda p: int(p.stem))
    pictures = list(enumerate(pictures))[::every]
    for number, picture in pictures:
        stem = f"{name}_{number:03}"
        content = picture.read_bytes() if quality is None else again(picture, quality)
        (out / "images" / f"{stem}.jpg").write_bytes(content)
        for folder, lines in zip(("labels", "ignore"), sort_boxes(boxes.get(int(picture.stem), []), width, height)):
            (out / folder / f"{stem}.txt").write_text("".join(f"{line}\n" for line in lines))
    return len(pictures)


def again(picture: Path, quality: int) -> bytes:
    ok, content = cv2.imencode(".jpg", cv2.imread(str(picture), cv2.IMREAD_UNCHANGED), [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not ok:
        raise ValueError(f"{picture}: cannot be written again")
    return content.tobytes()


def side(text: str, key: str) -> int:
    return int(re.search(rf"(?m)^{key} = (\d+)", text)[1])


def render(args: argparse.Namespace) -> int:
    out = Path(args.out)
    if out.exists() and any(out.iterdir()):
        raise ValueError(f"{out}: is not empty")
    for folder in ("images", "labels", "ignore"):
        (out / folder).mkdir(parents=True)
    count = 0
    for scenario in scenarios_of(args.to_score, args.scenarios):
        text = at_one_a_second(scenario.read_text())
        for seed in args.seeds:
            with tempfile.TemporaryDirectory() as folder:
                own, flight = Path(folder) / scenario.name, Path(folder) / "flight"
                own.write_text(text)
                done = subprocess.run([args.godwit, "sim", str(own), "--seed", str(seed), "--out", str(flight)],
                                      capture_output=True, text=True, check=False)
                if done.returncode:
                    raise ValueError(f"{scenario.stem}, seed {seed}: {done.stderr.strip() or done.stdout.strip()}")
                count += take(flight, f"{scenario.stem}_{seed}", side(text, "width"), side(text, "height"), out,
                              args.every, args.quality)
    (out / "purpose.json").write_text(json.dumps(
        {"for": "scoring" if args.to_score else "training", "seeds": args.seeds, "every": args.every, "quality": args.quality,
         "scenarios": [s.stem for s in scenarios_of(args.to_score, args.scenarios)]}, indent=1))
    return count


def check_to_train_on(folder: Path) -> None:
    """ValueError unless the folder was rendered to learn from."""
    told = json.loads((folder / "purpose.json").read_text())
    flown = sorted(set(told["scenarios"]) & set(FLOWN))
    if told["for"] != "training" or flown:
        raise ValueError(f"{folder}: rendered for {told['for']}, of {', '.join(told['scenarios'])}: not to be trained on")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--godwit", required=True, help="the program")
    parser.add_argument("--out", required=True, help="an empty or new folder")
    parser.add_argument("--seeds", type=int, nargs="+", required=True)
    parser.add_argument("--to-score", action="store_true", help="of the four scenarios that fly, never to be trained on")
    parser.add_argument("--scenarios", nargs="+", help="only these; not given: all")
    parser.add_argument("--every", type=int, default=1, help="only each so many-th picture of a flight: other flights show more")
    parser.add_argument("--quality", type=int, help="of JPEG, 1 to 100, for where there is little room; not given: as rendered")
    args = parser.parse_args()
    if args.every < 1 or not (args.quality is None or 1 <= args.quality <= 100):
        parser.error("--every must be at least 1, --quality from 1 to 100")
    print(f"{args.out}: {render(args)} pictures")


if __name__ == "__main__":
    try:
        main()
    except (ValueError, OSError) as e:
        sys.exit(f"render.py: {e}")
