"""pyads' own server of ADS, with the two variables of a PLC, which dies when it is asked to.

usage: ads_server.py ADDRESS CAPACITY MEMORY

Listens at an address of this machine on the port of ADS. MEMORY is a file that keeps count and
array (hexadecimal) over the death of the server, as a PLC keeps persistent variables. Lines on
standard input, each answered with what the memory holds: ``die N`` kills the server in the middle
of request N from now on (0: the next), ``damage`` changes a bit after the next write of the array.
"""

import os
import signal
import struct
import sys
from pathlib import Path

from pyads import constants
from pyads.testserver import AdsTestServer, AdvancedHandler, PLCVariable


class Handler(AdvancedHandler):
    def __init__(self, capacity, memory):
        super().__init__()
        self.memory, self.left, self.damage = memory, None, False
        count, table = bytes(4), bytes(8 * 5 * capacity)
        if memory.exists():
            count, table = map(bytes.fromhex, memory.read_text().split())
        self.count = PLCVariable("GVL.rotcal_count", count, constants.ADST_UINT32, "UDINT")
        self.table = PLCVariable("GVL.rotcal_table", table, constants.ADST_BIGTYPE, "ARRAY")
        self.add_variable(self.table)
        self.add_variable(self.count)

    def handle_request(self, request):
        data = request.ams_header.data
        group, handle = struct.unpack("<II", data[:8]) if len(data) >= 8 else (0, 0)
        writing = struct.unpack("<H", request.ams_header.command_id)[0] == 3
        if group == constants.ADSIGRP_SYM_VALBYHND and self.left is not None:
            if self.left == 0:
                self.die(data[12:] if writing and handle == self.table.handle else b"")
            self.left -= 1
        response = super().handle_request(request)
        if self.damage and writing and handle == self.table.handle and any(self.table.value):
            self.table.value = bytes([*self.table.value[:9], self.table.value[9] ^ 1,
                                      *self.table.value[10:]])  # fmt: skip
            self.damage = False
        self.keep()
        return response

    def die(self, data):
        """With half of an array taken."""
        half = len(data) // 2
        self.table.value = data[:half] + self.table.value[half:]
        self.keep()
        os.kill(os.getpid(), signal.SIGKILL)

    def keep(self):
        self.memory.write_text(f"{self.count.value.hex()} {self.table.value.hex()}")


def main():
    handler = Handler(int(sys.argv[2]), Path(sys.argv[3]))
    handler.keep()
    with AdsTestServer(handler, ip_address=sys.argv[1], logging=False):
        for line in sys.stdin:
            word, *number = line.split()
            if word == "die":
                handler.left = int(number[0])
            elif word == "damage":
                handler.damage = True
            print(handler.memory.read_text(), flush=True)  # noqa: T201


if __name__ == "__main__":
    main()
