"""How pymodbus lays numbers into registers: {type: {order: [[value, [words]], ..]}} as JSON.

Twice: `BinaryPayloadBuilder` knows all four orders; `convert_to_registers` knows the order of words, and
is compared here.
"""

import json
import logging
import struct

from pymodbus.client import ModbusTcpClient
from pymodbus.constants import Endian
from pymodbus.payload import BinaryPayloadBuilder

logging.disable(logging.CRITICAL)

WHOLE = {"u16": (16, False), "i16": (16, True), "u32": (32, False), "i32": (32, True),
         "u64": (64, False), "i64": (64, True)}
ADD = {"u16": "16bit_uint", "i16": "16bit_int", "u32": "32bit_uint", "i32": "32bit_int",
       "u64": "64bit_uint", "i64": "64bit_int", "f32": "32bit_float", "f64": "64bit_float"}
TYPES = {"u16": "UINT16", "i16": "INT16", "u32": "UINT32", "i32": "INT32", "u64": "UINT64",
         "i64": "INT64", "f32": "FLOAT32", "f64": "FLOAT64"}
ORDERS = {"abcd": (Endian.BIG, Endian.BIG), "cdab": (Endian.BIG, Endian.LITTLE),
          "badc": (Endian.LITTLE, Endian.BIG), "dcba": (Endian.LITTLE, Endian.LITTLE)}


def values(kind):
    if kind == "f32":
        return [struct.unpack("f", struct.pack("f", v))[0] for v in (0.1, -123.456, 1e-30, 3e38, 0.0)]
    if kind == "f64":
        return [0.1, -123.456789012345, 5e-324, 1.7e308, 0.0]
    bits, signed = WHOLE[kind]
    most = min(2 ** (bits - signed) - 1, 2**53)
    found = [0, 1, 0x12, most - 1, most, most // 3]
    return found + ([-1, -most, -(most // 3)] if signed else [])


def words(kind, order, value):
    byte, word = ORDERS[order]
    builder = BinaryPayloadBuilder(byteorder=byte, wordorder=word)
    getattr(builder, "add_" + ADD[kind])(value)
    found = builder.to_registers()
    if byte == Endian.BIG:
        other = ModbusTcpClient.convert_to_registers(
            value,
            getattr(ModbusTcpClient.DATATYPE, TYPES[kind]),
            word_order="big" if word == Endian.BIG else "little",
        )
        assert found == other, (kind, order, value, found, other)
    return found


print(json.dumps({
    kind: {order: [[value, words(kind, order, value)] for value in values(kind)] for order in ORDERS}
    for kind in ADD
}))
