"""A displacement sensor on a pseudo-terminal, written from a description of its protocol alone.

    sender.py text|frames|asked

The first line on standard output is the device's path. `text` and `frames` send by themselves, a sample each
millisecond of wall time; what the computer was late with follows in a burst. `asked` says a line of text
for each `M0` and a carriage return.

Commands come a line each on standard input:

    quiet            be silent; answers the number of samples sent so far
    steady SECONDS   send again for so long, whole samples alone; answers how many, and is silent then
    harm SEED COUNT  so many samples, some of them skipped (the counter goes on), cut short, spoilt, between
                     them noise, bursts and a silence; answers [[counter, um or null], ..] of all that were
                     sent whole and [skipped, spoilt], and is silent then
    follow           send again for as long as it lives; from now on each line of input says what it sees, in
                     micrometres or whatever else is counted, or `none`; `count` answers the number of
                     samples sent so far

Text: `#COUNTER MICROMETRES` and carriage return, line feed; counter round at 1000; `ERR` in place of a number.
Frames: 7E 81, counter (16 bit, low byte first), micrometres (24 bit two's complement, high byte first; the
least one says that there is none), CRC of these five bytes (CRC-16/XMODEM, which is binascii's crc_hqx),
high byte first.
"""

import binascii
import json
import os
import pty
import random
import select
import sys
import threading
import time
import tty

FORM = sys.argv[1]
ROUND = 1000 if FORM != "frames" else 65536
NONE = -(1 << 23)


def piece(count, um):
    count %= ROUND
    if FORM != "frames":
        return b"#%d %s\r\n" % (count, b"ERR" if um is None else b"%d" % um)
    body = count.to_bytes(2, "little") + (NONE if um is None else um).to_bytes(3, "big", signed=True)
    return b"\x7e\x81" + body + binascii.crc_hqx(body, 0).to_bytes(2, "big")


class Sensor:
    def __init__(self):
        self.device, self.client = pty.openpty()
        tty.setraw(self.client)
        self.count = 0

    def write(self, data):
        while data:
            data = data[os.write(self.device, data) :]

    def um(self):
        return (self.count * 37) % 16001 - 8000

    def sample(self):
        self.write(piece(self.count, self.um()))
        self.count += 1

    def steadily(self, until):
        """Whatever is due, until `until()`."""
        sent, begun = 0, time.monotonic()
        while not until():
            while sent < (time.monotonic() - begun) * 1000:
                self.sample()
                sent += 1
            time.sleep(0.0005)
        return sent


def harm(sensor, seed, total):
    draw = random.Random(seed)
    sent, skipped, spoilt = [], 0, 0
    for number in range(total):
        chance = draw.random()
        # The first and the last are whole, so that all between them is told.
        if 0 < number < total - 1 and chance < 0.03:
            missing = draw.randrange(1, 5)
            sensor.count += missing
            skipped += missing
        elif 0 < number < total - 1 and chance < 0.06:
            whole = piece(sensor.count, sensor.um())
            # Never its last byte alone: the line's end may be lost with it.
            sensor.write(whole[: draw.randrange(1, len(whole) - 2)])
            if FORM == "text":
                sensor.write(b"\xff\r\n")
            sensor.count += 1
            spoilt += 1
            continue
        elif chance < 0.08:
            sensor.write(bytes(draw.choice([0x80, 0xFE, 0x00, 0xC3]) for _ in range(draw.randrange(1, 40))))
            sensor.write(b"\r\n" if FORM == "text" else b"")
        elif chance < 0.082:
            time.sleep(0.5)
        um = None if draw.random() < 0.05 else sensor.um()
        whole = piece(sensor.count, um)
        cut = draw.randrange(len(whole)) if draw.random() < 0.3 else 0
        sensor.write(whole[:cut])
        if cut:
            time.sleep(0.0005)
        sensor.write(whole[cut:])
        sent.append([sensor.count % ROUND, um])
        sensor.count += 1
        if draw.random() < 0.5:
            time.sleep(0.001)
    return [sent, [skipped, spoilt]]


def follow(sensor):
    """Sees what it is told, for as long as it lives."""
    seen = [None]

    def listen():
        for line in sys.stdin:
            if line.strip() == "count":
                tell(sensor.count)
            else:
                seen[0] = None if line.strip() == "none" else int(line)

    threading.Thread(target=listen, daemon=True).start()
    sensor.um = lambda: seen[0]
    sensor.steadily(lambda: False)


def answer(sensor):
    """For as long as it lives."""
    begun = b""
    while True:
        begun += os.read(sensor.device, 64)
        while b"M0\r" in begun:
            begun = begun.split(b"M0\r", 1)[1]
            sensor.sample()


def tell(what):
    print(json.dumps(what), flush=True)


def commanded():
    return select.select([sys.stdin], [], [], 0)[0]


def main():
    sensor = Sensor()
    print(os.ttyname(sensor.client), flush=True)
    if FORM == "asked":
        answer(sensor)
    sensor.steadily(commanded)
    for line in sys.stdin:
        word, *numbers = line.split()
        if word == "quiet":
            tell(sensor.count)
        elif word == "steady":
            end = time.monotonic() + float(numbers[0])
            tell(sensor.steadily(lambda: time.monotonic() >= end))
        elif word == "harm":
            tell(harm(sensor, *map(int, numbers)))
        elif word == "follow":
            follow(sensor)


main()
