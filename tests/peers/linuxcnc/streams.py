"""What is listened to beside LinuxCNC: the axes' positions and a laser, each at a TCP port of its own.

    streams.py POSITIONS_PORT LASER_PORT

Positions: whoever connects gets what `halsampler -t` says, from a halsampler of its own. Laser: a sample for
each servo period, `+1.234567,COUNTER` and carriage return, line feed (counter round at 10000, `NOECHO` in
place of the number), sent evenly, as a sensor with a clock of its own does: 40 ms after its time and as much
later as was asked for. Sensors about the datum cylinder: a serial port each (a pseudo-terminal), a line for each fifth
servo period. Says `sensor DEVICE` for each of them, then `ready` when all are open; on standard input `delay MILLISECONDS`, which
is answered by the same line. Ends with its standard input.
"""

import collections
import os
import pty
import socket
import subprocess
import sys
import termios
import threading
import time
import tty

PERIOD_S = 0.001
# For what halsampler and this computer are late with.
BASE_S = 0.040
delay_s = 0.0
children = []


def halsampler(channel, out):
    # A line at a time, not when 4096 bytes have gathered.
    words = ["stdbuf", "-oL", "halsampler", "-t", "-c", channel]
    child = subprocess.Popen(words, stdout=out, stdin=subprocess.DEVNULL)
    children.append(child)
    return child


def listener(port):
    sock = socket.socket()
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    sock.bind(("127.0.0.1", port))
    sock.listen(1)
    return sock


def positions(sock):
    while True:
        client, _ = sock.accept()
        child = halsampler("0", client.fileno())
        # Nobody says anything to it: an end is a client that has gone.
        while client.recv(100):
            pass
        child.terminate()
        child.wait()
        client.close()


class Laser:
    channel = "1"
    words = 3

    def __init__(self):
        self.samples = collections.deque()
        # Time of tick 0 by the earliest lines so far.
        self.zero_s = None
        self.client = None

    def hear(self):
        """Ticks as they come. The first line of a batch that waited is old: the least counts."""
        child = halsampler(self.channel, subprocess.PIPE)
        begun_s = time.monotonic()
        for line in child.stdout:
            now_s = time.monotonic()
            words = line.split()
            if len(words) != self.words:
                continue
            tick = int(words[0])
            # What had gathered before is over after a second; the zero is then found once and kept.
            since_s = now_s - begun_s
            if since_s < 1.0:
                continue
            if since_s < 3.0:
                zero_s = now_s - tick * PERIOD_S
                self.zero_s = zero_s if self.zero_s is None else min(self.zero_s, zero_s)
                continue
            self.keep(tick, words[1:])

    def keep(self, tick, words):
        self.samples.append((tick, float(words[0]), words[1] == b"1"))

    def send(self):
        while True:
            if not self.samples:
                time.sleep(0.001)
                continue
            sample = self.samples.popleft()
            due_s = self.zero_s + sample[0] * PERIOD_S + BASE_S + delay_s
            wait_s = due_s - time.monotonic()
            if wait_s > 0.0:
                time.sleep(wait_s)
            self.report(*sample)

    def report(self, tick, mm, sees):
        value = "%+.6f" % mm if sees else "NOECHO"
        client = self.client
        if client is None:
            return
        try:
            client.sendall(b"%s,%d\r\n" % (value.encode(), tick % 10000))
        except OSError:
            self.client = None

    def serve(self, sock):
        while True:
            client, _ = sock.accept()
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self.client = client


class Sensors(Laser):
    """Those about the datum cylinder."""

    channel = "2"
    words = 4
    every = 5

    def __init__(self):
        super().__init__()
        self.ports = [pty.openpty() for _ in range(3)]
        for device, client_side in self.ports:
            tty.setraw(client_side)
            os.set_blocking(device, False)

    def keep(self, tick, words):
        if tick % self.every == 0:
            self.samples.append((tick, [float(word) for word in words]))

    def report(self, tick, distances):
        for (device, _), mm in zip(self.ports, distances):
            try:
                os.write(device, b"%+.6f,%d\r\n" % (mm, tick // self.every % 10000))
            except BlockingIOError:
                # Nobody reads.
                termios.tcflush(device, termios.TCOFLUSH)


def main():
    global delay_s
    laser = Laser()
    sensors = Sensors()
    tasks = [
        (positions, listener(int(sys.argv[1]))),
        (laser.serve, listener(int(sys.argv[2]))),
        (laser.hear,),
        (laser.send,),
        (sensors.hear,),
        (sensors.send,),
    ]
    for task, *arguments in tasks:
        threading.Thread(target=task, args=arguments, daemon=True).start()
    while not (laser.samples and sensors.samples):
        time.sleep(0.01)
    for _, client_side in sensors.ports:
        print("sensor", os.ttyname(client_side), flush=True)
    print("ready", flush=True)
    for line in sys.stdin:
        word, value = line.split()
        assert word == "delay", line
        delay_s = float(value) / 1000.0
        print(line.strip(), flush=True)
    for child in children:
        child.terminate()
    for child in children:
        child.wait()
    os._exit(0)


main()
