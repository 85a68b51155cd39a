"""docs/troubleshooting.md: every reason and event that a flight tells is in it, word by word in `backticks`."""
import glob
import os
import re

from documents.commands import read

# Reasons of states and frames, and what the pipeline's threads tell, as the sources have them.
WHERE = ('vo_core/**/*.cpp', 'firmware_app/pipeline/*.cpp', 'firmware_app/pipeline/*.h')
TOLD = re.compile(r'(?:\breason(?:_|->|\.)?\s*(?:=\s*\{?|assign(?:_measured)?\()|Reason\{|assign_measured\(|(?:\.|->)assign\(|refusal_\s*=\s*\{|'
                  r'without_pose\(e,\s*\{|refuse\(|break_frame\(|\bwhy\s*=\s*\{?|\? |\S \? [\w.]+ : |k(?:Warning|Info),\s*(?:\w+ \? )?)'
                  r'\s*"([^"]+)"(?:\s*:\s*"([^"]+)")?')
SILENCE = re.compile(r'(?:camera|imu)_silence_\(\s*"([^"]+)",\s*"([^"]+)"')
# Names of threads and numbers of classes, no reasons.
NO_REASON = re.compile(r'gw-|%[sd]|^\S{1,4}$')


def reasons(root):
    out = {}
    for pattern in WHERE:
        for file in sorted(glob.glob(os.path.join(root, pattern), recursive=True)):
            text = read(file)
            for match in [*TOLD.finditer(text), *SILENCE.finditer(text)]:
                for told in match.groups():
                    if told and not NO_REASON.search(told):
                        out.setdefault(told, os.path.relpath(file, root))
    return out


def wrong_reasons(root, text):
    told = set(re.findall(r'`([^`]+)`', text))
    for reason, file in reasons(root).items():
        if reason not in told:
            yield 1, f'`{reason}` is told by {file} and not explained'
