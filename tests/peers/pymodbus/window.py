"""A driver for the line window that is not ours: written from docs/line-window.md alone, on pymodbus.

    window.py tcp PORT TRIAL
    window.py rtu PATH TRIAL

Trials: lines (each line of standard input is streamed; what the status says when it is done goes out as a
line of JSON), refusals, hold, heartbeat. Ends with 0 and `as documented`, or says what is not so.
"""

import json
import sys
import time

from pymodbus.client import ModbusSerialClient, ModbusTcpClient

HOLD, SEQUENCE, HEARTBEAT, ACKNOWLEDGE, CRC, LENGTH, CHUNK = range(7)
COUNT = 45
IDLE, RUNNING, HELD = 1, 2, 3
FEED = "G53 G1 X60 F3000"


def check_sum(text):
    """CRC-16/MODBUS."""
    crc = 0xFFFF
    for byte in text:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xA001 if crc & 1 else 0)
    return crc


assert check_sum(b"123456789") == 0x4B37


def registers(text):
    padded = text + b"\0" * (len(text) % 2)
    return [padded[at] << 8 | padded[at + 1] for at in range(0, len(padded), 2)]


class Window:
    def __init__(self, client):
        assert client.connect(), "no connection"
        self.client, self.beat = client, 0
        self.sequence = self.status()["accepted"]

    def write(self, at, words):
        """The exception's code, if it is refused."""
        reply = self.client.write_registers(at, words)
        return reply.exception_code if reply.isError() else None

    def put(self, at, words):
        assert self.write(at, words) is None, f"{words} at {at} is refused"
        assert self.client.read_holding_registers(at, count=len(words)).registers == words

    def live(self):
        self.beat = (self.beat + 1) % 65536
        self.put(HEARTBEAT, [self.beat])

    def status(self):
        block = self.client.read_input_registers(0, count=COUNT).registers
        assert len(block) == COUNT and block[0] == block[44], "a torn block that nobody made"
        assert block[1] == 1, "another version of the window"

        def number(at, kind):
            kind = getattr(self.client.DATATYPE, kind)
            return self.client.convert_from_registers(block[at : at + kind.value[1]], kind)

        names = ["state", "alarm", "accepted", "executed", "error", "probe"]
        found = dict(zip(names, block[2:8]))
        found |= {"latches": block[10], "beat": block[11], "time": number(12, "FLOAT64")}
        found["latch_time"] = number(16, "FLOAT64")
        found["latch"] = [number(at, "INT32") for at in range(20, 32, 2)]
        found["position"] = [number(at, "INT32") for at in range(32, 44, 2)]
        return found

    def lay_down(self, line, **other):
        text = line.encode()
        self.put(ACKNOWLEDGE, [other.get("acknowledge", self.sequence)])
        self.put(CRC, [other.get("crc", check_sum(text))])
        self.put(LENGTH, [other.get("length", len(text))])
        self.put(CHUNK, registers(text))

    def offer(self, line, **other):
        """Lay it down, write the sequence; the status once the control has looked at it."""
        if other.get("alive", True):
            self.live()
        self.lay_down(line, **other)
        self.sequence = self.sequence % 65535 + 1
        self.put(SEQUENCE, [self.sequence])
        return self.until(lambda status: status["accepted"] == self.sequence, other.get("alive", True))

    def until(self, right, alive=True, seconds=30):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if alive:
                self.live()
            status = self.status()
            if right(status):
                return status
        raise AssertionError(f"not within {seconds} s: {status}")

    def execute(self, line):
        taken = self.offer(line)
        assert taken["error"] == 0, f"{line} is refused: {taken}"
        return self.until(lambda status: status["executed"] == self.sequence)


def lines(window):
    for line in sys.stdin:
        done = window.execute(line.strip())
        assert done["state"] == IDLE, done
        print(json.dumps(done), flush=True)


def refusals(window):
    window.execute("G21 G90 G94")
    stood = window.status()

    def refused(why, line=FEED, **other):
        status = window.offer(line, **other)
        assert status["error"] == why, f"{why} is not {status['error']}: {line} {other}"
        assert status["state"] == IDLE and status["position"] == stood["position"], status

    refused(1, length=0)
    refused(1, length=201)
    refused(2, crc=check_sum(FEED.encode()) ^ 0x0100)
    refused(2, length=len(FEED) - 1)
    refused(3, line="HELLO, MACHINE")
    refused(4, acknowledge=(window.sequence - 1) % 65536)
    time.sleep(2.2)
    refused(5, alive=False)
    out_of_turn(window, stood)
    beyond(window)
    there = window.execute(FEED)
    assert there["position"][0] == 60_000, there
    again(window, there)
    while_it_moves(window)


def out_of_turn(window, stood):
    """A sequence that does not follow is ignored, whatever it is."""
    window.lay_down(FEED)
    for sequence in (window.sequence + 2, window.sequence + 1000, 0):
        window.live()
        window.put(SEQUENCE, [sequence])
        time.sleep(0.05)
        status = window.status()
        assert status["accepted"] == window.sequence, f"{sequence} was looked at: {status}"
        assert status["position"] == stood["position"], status


def again(window, there):
    """The same sequence once more is no second command, whatever text goes with it."""
    window.lay_down("G53 G1 X0 F3000")
    for _ in range(3):
        window.live()
        window.put(SEQUENCE, [window.sequence])
        time.sleep(0.05)
        status = window.status()
        assert status["accepted"] == status["executed"] == window.sequence, status
        assert status["position"] == there["position"], status


def beyond(window):
    """Only the two blocks are there, and only the functions that they need."""
    assert window.write(106, [1]) == 2
    assert window.write(100, [0] * 7) == 2
    assert window.client.read_input_registers(0, count=46).exception_code == 2
    assert window.client.read_coils(0, count=1).exception_code == 1
    assert window.client.write_coil(0, True).exception_code == 1


def while_it_moves(window):
    assert window.offer("G53 G1 X61 F60")["error"] == 0
    assert window.offer("G53 G1 X0 F3000")["error"] == 6
    window.until(lambda status: status["state"] == IDLE)
    there = window.execute("G53 G1 X62 F300")
    assert there["position"][0] == 62_000, there


def under_way(window):
    window.execute("G21 G90 G94")
    begun = window.offer("G53 G1 X100 F600")
    assert begun["error"] == 0 and begun["state"] == RUNNING, begun
    moving = window.until(lambda status: status["position"][0] > begun["position"][0])
    assert moving["state"] == RUNNING and moving["executed"] != window.sequence, moving


def stays(window, alive):
    """It stands short of its target, nothing is done, and nothing moves it again."""
    held = window.until(lambda status: status["state"] == HELD, alive, 4)
    time.sleep(0.2)
    stood = window.status()["position"]
    assert 0 < stood[0] < 100_000, stood
    assert window.offer("G53 G1 X0 F600")["error"] == 6
    window.put(HOLD, [0])
    window.live()
    time.sleep(0.3)
    after = window.status()
    assert after["state"] == HELD and after["position"] == stood, after
    assert after["executed"] != window.sequence, after
    return held


def hold(window):
    under_way(window)
    window.put(HOLD, [1])
    assert stays(window, True)["alarm"] == 0


def heartbeat(window):
    under_way(window)
    begun = time.monotonic()
    assert stays(window, False)["alarm"] == 64
    # Two seconds, and what else was asked meanwhile.
    assert time.monotonic() - begun > 1.9


def main():
    kind, at, trial = sys.argv[1:]
    if kind == "tcp":
        client = ModbusTcpClient("127.0.0.1", port=int(at), timeout=20, retries=0)
    else:
        client = ModbusSerialClient(at, baudrate=115200, timeout=20, retries=0)
    {"lines": lines, "refusals": refusals, "hold": hold, "heartbeat": heartbeat}[trial](Window(client))
    print("as documented", flush=True)


main()
