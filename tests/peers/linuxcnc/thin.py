"""Leave out polls of a captured talk with LinuxCNC: thin.py CAPTURE > THINNED.

What only asks may be asked more or less often in a replay. Between two commands the first and the last of
the questions for PROGRAM_STATUS and for ABS_ACT_POS stay, each with its answer, and the first and the last
look at each file. No line that stays is altered.
"""
import sys

lines = open(sys.argv[1]).read().splitlines()
drop = set()
asked, looks = {}, {}      # (link, question) -> [(line of `>`, line of `<`)]; (link) -> [line]
open_question = {}


def thin(polls):
    for place in polls[1:-1]:
        drop.update(place)
    polls.clear()


for number, line in enumerate(lines):
    if line.startswith("#"):
        continue
    _, link, mark, rest = line.split(" ", 3)
    if mark == ">":
        if rest in ("get PROGRAM_STATUS\\n", "get ABS_ACT_POS\\n"):
            open_question[link] = (rest, number)
            continue
        for key in [key for key in asked if key[0] == link]:
            thin(asked[key])
        thin(looks.setdefault(link, []))
        open_question.pop(link, None)
    elif mark == "<" and link in open_question:
        rest, number_of = open_question.pop(link)
        asked.setdefault((link, rest), []).append((number_of, number))
    elif mark == "<" and "trued.log" in rest:
        looks.setdefault(link, []).append((number,))
for polls in [*asked.values(), *looks.values()]:
    thin(polls)
kept = [line for number, line in enumerate(lines) if number not in drop]
kept[1:1] = [
    "# LinuxCNC 2.9 on the rig of tests/peers/linuxcnc. Left out: of the questions for PROGRAM_STATUS and",
    "# ABS_ACT_POS between two commands, and of the looks at the log, all but the first and the last.",
]
print("\n".join(kept))
