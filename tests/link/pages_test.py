#!/usr/bin/env python3
"""What was learnt by flying a real ArduPilot stands in docs/ardupilot.md, and the page and the doctor say the same: each
parameter that the doctor reads is in the page's table, with the value that it wants.

    pages_test.py"""
import pathlib
import re
import sys

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
from checks import check, run_cases  # noqa: E402

ROOT = pathlib.Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs/ardupilot.md").read_text(encoding="utf-8")
DOCTOR = (ROOT / "firmware_app/link/doctor.cpp").read_text(encoding="utf-8")
TABLE = PAGE[PAGE.index("## Parameters of the autopilot"):PAGE.index("## Flying")]


def rows():
    """{parameter: (values, why)}: a row's first name whole, others as endings or whole ("VISO_POS_X, _Y, _Z")."""
    out = {}
    for line in TABLE.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if len(cells) != 3 or not re.match(r"[A-Z]", cells[0]):
            continue
        first = ""
        for name in cells[0].split(", "):
            first = first or name
            whole = name if "_" in name.strip("_") else re.sub(r"_[A-Z0-9]+$", "_" + name.strip("_"), first)
            out[whole] = (cells[1], cells[2])
    return out


def doctor():
    told = rows()
    names = set(re.findall(r'"((?:CAN|VISO|AHRS|EK3)_[A-Z0-9_]+[A-Z0-9])"', DOCTOR)) - {"EK3_SRC"}
    check(len(names) >= 19, "the doctor reads %d parameters by their names" % len(names))
    for name in sorted(names):
        known = name in told or any(name.startswith(row[:-1]) for row in told if row.endswith("*"))
        check(known or re.match(r"EK3_SRC\d_", name), name + " is in the page's table")
    for name, value in re.findall(r'e->must\("([A-Z0-9_]+)", (\d+),', DOCTOR):
        values = told.get(name, ("", ""))[0]
        check(str(value) in re.findall(r"\d+", values), "%s %s: the page says %s" % (name, value, values))


def learnt():
    for what, words in {
            "two restarts for a serial port over CAN": ("restart again", "works from the second one on"),
            "EK3_SRC_OPTIONS 0": ("| EK3_SRC_OPTIONS | 0 |", "fused while flying on GPS"),
            "a switch of two positions": ("| RCx_OPTION | 90 |", "take one of three, or fill EK3_SRC3_* like EK3_SRC2_*"),
            "what is forwarded to telemetry": ("| SERIALn_OPTIONS | 1024 |", "It stops our texts there, too"),
            "velocities are compared, not positions": ("VISV with XKF1's VN and VE", "Positions prove nothing"),
            "a SITL over the network": ("NET_ENABLE 1, NET_P1_TYPE 2, NET_P1_PROTOCOL 2", "NET_P1_PORT"),
            "what ArduSub lacks": ("ArduSub 4.5 has no VISO_QUAL_MIN",),
            "an attitude that agrees before gravity is known": ("repeats the autopilot's own attitude, which agrees",),
            "no zeros while lost": ("with the last position, at rest",),
            "the arm on the bench": ("is left out then",)}.items():
        flat = " ".join(PAGE.split())
        check(all(word in flat for word in words), what)


if __name__ == "__main__":
    run_cases({"doctor": doctor, "learnt": learnt}, ",".join(sys.argv[1:]))
