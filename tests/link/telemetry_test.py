#!/usr/bin/env python3
"""Decodes real telemetry frames with cantools and config/godwit.dbc: telemetry_test.py godwit_telemetry_peer godwit.dbc"""
import subprocess
import sys

import cantools


def main():
    database = cantools.database.load_file(sys.argv[2])
    lines = subprocess.run([sys.argv[1]], check=True, capture_output=True, text=True).stdout.splitlines()
    seen, wrong, compared = set(), [], 0
    for line in lines:
        left, _, right = line.partition("|")
        given = {k: float(v) for k, v in (word.split("=") for word in left.split())}
        for word in right.split():
            can_id, data = int(word.split(":")[0], 16), bytes.fromhex(word.split(":")[1])
            message = database.get_message_by_frame_id(can_id)
            if len(data) != message.length:
                wrong.append("%s has %d bytes" % (message.name, len(data)))
            decoded = message.decode(data, decode_choices=False)
            for signal in message.signals:
                seen.add((message.name, signal.name))
                value = given[signal.name]
                if signal.is_float:
                    tolerance = abs(value) * 1e-7 + 1e-7
                else:
                    # A number beyond its field is sent as the nearest one that fits.
                    value = min(max(value, signal.minimum), signal.maximum)
                    tolerance = 0.5001 * float(signal.scale) if signal.scale != 1 else 0.5001
                compared += 1
                if abs(decoded[signal.name] - value) > tolerance:
                    wrong.append("%s.%s: %r, given %r" % (message.name, signal.name, decoded[signal.name], value))
    total = sum(len(m.signals) for m in database.messages)
    print("%d lines, %d signals of %d seen, %d values compared, %d wrong" % (len(lines), len(seen), total, compared, len(wrong)))
    for text in wrong[:10]:
        print("  " + text)
    return 1 if wrong or len(seen) != total or len(lines) != 2000 else 0


if __name__ == "__main__":
    sys.exit(main())
