"""A pymodbus server that can be told what to do wrong.

    server.py tcp            on a free port of this computer
    server.py rtu PATH       on a serial device

Framing, decoding and the registers are pymodbus's. What is ours: every reply may be spoilt on its way
out, and every write is counted. Commands come a line each on stdin, each is answered by one line of
JSON on stdout; the first line says where it listens.

    value N          every input register, and holding registers 0 to 9, hold N
    faults A B ..    what happens to the next requests, one each
    sense MS COUNT   be a sensor: so many measurements, one each so many milliseconds, in input registers 100
                     (status), 101 (counter), 102 and 103 (micrometres, low word first), all at once
    sensed           how many measurements it has made; each is 37 um more than the one before, status 2
                     with each tenth
    writes           all writes so far: [[address, [words]], ..]
    requests         how many requests have come

Faults: none, drop, reset (the connection), exception:CODE (nothing is done), unit, transaction,
function, address (of a write's echo), fewer (one register, in a sound frame), more, short (the frame's
end is missing), corrupt (one bit), double (twice at once), delay:SECONDS, trickle:SECONDS (in three
parts). Replies leave in the order of their requests.
"""

import asyncio
import json
import socket
import struct
import sys
import time
from collections import deque

from pymodbus.datastore import ModbusSequentialDataBlock, ModbusServerContext, ModbusSlaveContext
from pymodbus.pdu import ExceptionResponse
from pymodbus.server import ModbusSerialServer, ModbusTcpServer
from pymodbus.server.requesthandler import ServerRequestHandler

faults, writes, requests = deque(), [], 0
sensed, sensing = 0, None


class Counted(ModbusSequentialDataBlock):
    """Keeps what a client writes; addresses count from 0 on the wire and from 1 here."""

    def setValues(self, address, values):
        writes.append([address - 1, list(values)])
        super().setValues(address, values)


inputs = ModbusSequentialDataBlock(1, [0] * 200)
holding = Counted(1, [0] * 200)
bits = ModbusSequentialDataBlock(1, [False, True, True] * 20)
context = ModbusServerContext(
    slaves=ModbusSlaveContext(ir=inputs, hr=holding, co=bits, di=bits), single=True
)


class Handler(ServerRequestHandler):
    """Each request draws a fault; the replies go out one after the other."""

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.outgoing = asyncio.Queue()
        self.sender = asyncio.ensure_future(self.send_in_order())

    async def send_in_order(self):
        while True:
            wait, part = await self.outgoing.get()
            await asyncio.sleep(wait)
            self.send(part)

    async def handle_request(self):
        global requests
        request = self.last_pdu
        if not request:
            return
        requests += 1
        fault, _, argument = (faults.popleft() if faults else "none").partition(":")
        if fault == "exception":
            reply = ExceptionResponse(request.function_code, int(argument))
        else:
            reply = await request.update_datastore(context[request.dev_id])
        reply.transaction_id, reply.dev_id = request.transaction_id, request.dev_id
        if fault == "reset":
            link = self.transport.get_extra_info("socket")
            link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            self.transport.abort()
        elif fault != "drop":
            self.reply(reply, fault, float(argument) if fault in ("delay", "trickle") else 0)

    def reply(self, reply, fault, seconds):
        spoil(reply, fault)
        frame = self.framer.buildFrame(reply)
        if fault == "short":
            frame = frame[:-2]
        if fault == "corrupt":
            frame = frame[:-3] + bytes([frame[-3] ^ 4]) + frame[-2:]
        if fault == "double":
            frame += frame
        third = len(frame) // 3
        parts = [frame[:third], frame[third : 2 * third], frame[2 * third :]]
        for part in parts if fault == "trickle" else [frame]:
            self.outgoing.put_nowait((seconds, part))


def spoil(reply, fault):
    registers = getattr(reply, "registers", None)
    if fault == "unit":
        reply.dev_id += 1
    if fault == "transaction":
        reply.transaction_id ^= 0x55
    if fault == "function":
        reply.function_code = 3 if reply.function_code == 4 else 4
        reply.registers = registers or [0]
        reply.encode = lambda: bytes([2 * len(reply.registers)]) + b"".join(
            struct.pack(">H", word) for word in reply.registers
        )
    if fault == "address":
        reply.address += 1
    if fault == "fewer" and registers:
        reply.registers = registers[:-1]
    if fault == "more" and registers:
        reply.registers = registers + [registers[0]]


async def sense(milliseconds, count):
    """Asyncio runs one thing at a time: no reply is made between two of the registers."""
    global sensed
    begun = time.monotonic()
    while sensed < count:
        sensed += 1
        um = sensed * 37 & 0xFFFFFFFF
        words = [2 if sensed % 10 == 0 else 0, sensed & 0xFFFF, um & 0xFFFF, um >> 16]
        inputs.setValues(101, words)
        await asyncio.sleep(begun + sensed * milliseconds / 1000 - time.monotonic())


def command(line):
    global sensing, sensed
    word, *rest = line.split()
    if word == "sense":
        sensed = 0
        sensing = asyncio.ensure_future(sense(float(rest[0]), int(rest[1])))
        return True
    if word == "sensed":
        return sensed
    if word == "value":
        inputs.values = [int(rest[0])] * 200
        holding.values[:10] = [int(rest[0])] * 10
        return True
    if word == "faults":
        faults.clear()
        faults.extend(rest)
        return True
    return {"writes": writes, "requests": requests}[word]


def tell(answer):
    print(json.dumps(answer), flush=True)


async def main():
    if sys.argv[1] == "tcp":
        server = ModbusTcpServer(context, address=("127.0.0.1", 0))
    else:
        server = ModbusSerialServer(context, port=sys.argv[2], baudrate=115200)
    server.callback_new_connection = lambda: Handler(server, None, None, None)
    await server.serve_forever(background=True)
    sockets = getattr(server.transport, "sockets", None)
    tell(sockets[0].getsockname()[1] if sockets else sys.argv[2])
    stdin = asyncio.StreamReader()
    loop = asyncio.get_running_loop()
    await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(stdin), sys.stdin)
    while line := await stdin.readline():
        tell(command(line.decode()))


asyncio.run(main())
