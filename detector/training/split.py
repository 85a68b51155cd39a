"""Which picture is for what. A fixed rule before anything else sees a set, so that no run can train on what is scored.

  train     is trained on
  choose    cut from what would be trained on: decides which of a run's weights are kept, and is never trained on
  held_out  is scored: COCO val2017 and VisDrone val as published; of each aerial set the last fifth of every flight (by
            frame number), because neighbouring frames of a flight show the same cars
  unseen    whole flights of which no frame is trained on or chooses: another place, other cars. Their last fifths are in
            held_out as well, so that its figures stay comparable with those of older weights (which trained on the rest)
"""
from __future__ import annotations

import re
from pathlib import Path

PARTS = ("train", "choose", "held_out", "unseen")
# Pictures that other tests of the project cut their walking figures from: never trained on.
SPRITE_SOURCES = frozenset({"000000000113", "000000000241", "000000009483"})
# Flights of which nothing is trained on, by how their frames' names begin: folders 5 and 6, and MunichStreet.
UNSEEN = {"cats_topdown": ("5_", "6_"), "aerial_cars": ("MunichStreet",)}
HELD_OUT_SHARE = 5  # one in five
CHOOSE_SHARE = 8  # of what is left, one in eight
FLIGHT_GAP = 40  # frame numbers further apart than this belong to two flights


def flight_and_frame(stem: str) -> tuple[str, int]:
    """Frame name -> flight and number in it ("DJI_0005-0018" -> "DJI_0005", 18; "Drone2_(489)" -> "Drone2", 489)."""
    match = re.fullmatch(r"(.*?)[-_ ]*\(?(\d+)\)?", stem)
    if match is None:
        raise ValueError(f"frame name without a number: {stem}")
    return match.group(1), int(match.group(2))


def flights_of(stems: list[str]) -> list[list[str]]:
    """The frames of each flight in order. A gap in a flight's numbers begins another one."""
    numbered: dict[str, list[tuple[int, str]]] = {}
    for stem in stems:
        flight, number = flight_and_frame(stem)
        numbered.setdefault(flight, []).append((number, stem))
    out = []
    for frames in numbered.values():
        frames.sort()
        for i, (number, stem) in enumerate(frames):
            if i == 0 or number - frames[i - 1][0] > FLIGHT_GAP:
                out.append([])
            out[-1].append(stem)
    return out


def _of_flights(stems: list[str], part: str, unseen: tuple[str, ...]) -> list[str]:
    if part == "unseen":
        return sorted(s for s in stems if s.startswith(unseen))
    out = []
    for frames in flights_of(stems):
        held_out = len(frames) - len(frames) // HELD_OUT_SHARE
        # The later frames choose: they lie next to those that are scored.
        choose = held_out - held_out // CHOOSE_SHARE
        chosen = {"train": frames[:choose], "choose": frames[choose:held_out], "held_out": frames[held_out:]}[part]
        out += chosen if part == "held_out" else [s for s in chosen if not s.startswith(unseen)]
    return sorted(out)


def _every(stems: list[str], part: str) -> list[str]:
    """Pictures that have nothing to do with each other: every eighth chooses."""
    return [s for i, s in enumerate(stems) if (i % CHOOSE_SHARE == CHOOSE_SHARE - 1) == (part == "choose")]


def names(root: Path, source: str, part: str) -> list[str]:
    """Stems of the pictures of one part of a set. A part that a set does not have is empty."""
    if part not in PARTS:
        raise ValueError(f"{part}: no part; known: {' '.join(PARTS)}")
    if source == "simulated":  # a folder of render.py's: made to train on, or to be scored, as a whole
        return sorted(p.stem for p in (root / "images").glob("*.jpg")) if part in ("train", "held_out") else []
    if source == "coco":
        if part == "unseen":
            return []
        folder = root / "coco256" / "images" / ("val2017" if part == "held_out" else "train2017")
        stems = sorted(p.stem for p in folder.glob("*.jpg"))
        return stems if part == "held_out" else _every([s for s in stems if s not in SPRITE_SOURCES], part)
    if source == "visdrone":
        if part == "unseen":
            return []
        stems = sorted((root / "visdrone_mini" / ("val.list" if part == "held_out" else "train.list")).read_text().split())
        return stems if part == "held_out" else _every(stems, part)
    return _of_flights([p.stem for p in (root / source / "images").glob("*.jpg")], part, UNSEEN[source])
