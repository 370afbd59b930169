"""pymodbus as a client: one request a line on standard input, one answer a line.

client.py PORT [SOURCE ADDRESS]. Answers: numbers, `ok`, `exception CODE`, `lost`.
"""
import sys

from pymodbus.client import ModbusTcpClient
from pymodbus.exceptions import ModbusException


def asked(client, word, numbers):
    at = numbers[0]
    if word == "input":
        return client.read_input_registers(at, count=numbers[1])
    if word == "holding":
        return client.read_holding_registers(at, count=numbers[1])
    if word == "discrete":
        return client.read_discrete_inputs(at, count=numbers[1])
    if word == "bits":
        return client.read_coils(at, count=numbers[1])
    if word == "coil":
        return client.write_coil(at, bool(numbers[1]))
    if word == "coils":
        return client.write_coils(at, [bool(value) for value in numbers[1:]])
    if word == "register":
        return client.write_register(at, numbers[1])
    if word == "registers":
        return client.write_registers(at, numbers[1:])
    raise SystemExit(f"no such word: {word}")


def told(reply, word):
    if reply.isError():
        return f"exception {reply.exception_code}"
    if word in ("input", "holding"):
        return " ".join(map(str, reply.registers))
    if word in ("discrete", "bits"):
        return " ".join(str(int(bit)) for bit in reply.bits)
    return "ok"


def main():
    source = (sys.argv[2], 0) if len(sys.argv) > 2 else None
    client = ModbusTcpClient(
        "127.0.0.1", port=int(sys.argv[1]), source_address=source, timeout=20, retries=0
    )
    print("ok" if client.connect() else "lost", flush=True)
    for line in sys.stdin:
        word, *numbers = line.split()
        try:
            print(told(asked(client, word, [int(number) for number in numbers]), word), flush=True)
        except (ModbusException, OSError):
            print("lost", flush=True)


main()
