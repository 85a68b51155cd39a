"""godwit_link_peer, the program that the link's Python tests drive."""
import json
import subprocess
import time


def start(program, *arguments):
    return subprocess.Popen([program, "--can", "multicast:0", *arguments], stdout=subprocess.PIPE, text=True)


def finish(process, spin=None):
    """(what it told at its end, its exit code). `spin` goes on with the other side of the bus meanwhile."""
    end = time.monotonic() + 60
    while process.poll() is None and time.monotonic() < end:
        spin(0.05) if spin else time.sleep(0.05)
    out = process.communicate(timeout=5)[0]
    return json.loads(out.strip().split("\n")[-1]), process.returncode


def finish_after(process, ap, seconds):
    ap.spin(seconds)
    return finish(process, ap.spin)
