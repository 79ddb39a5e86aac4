"""A program on a pseudo terminal that can be typed on, read, and taken away."""

import fcntl
import os
import pty
import re
import select
import subprocess
import termios
from functools import partial
from threading import Event, Thread

import warm
from live_cell import wait_until

CONTROL = re.compile(rb"\x1b\[[0-9;?]*[a-zA-Z]|\r")


class PseudoTerminal:
    """Runs a program that has this as its controlling terminal; ``text`` is what it showed."""

    def __init__(self, command, prepare=None):
        self._master, slave = pty.openpty()

        def begin():
            prepare()
            fcntl.ioctl(0, termios.TIOCSCTTY, 0)

        streams = {"stdin": slave, "stdout": slave, "stderr": slave, "start_new_session": True}
        start = warm.popen
        if prepare is not None:
            start = partial(subprocess.Popen, preexec_fn=begin)
        self.process = start([*map(str, command)], **streams)
        os.close(slave)
        self._shown = b""
        self._gone = Event()
        self._reader = Thread(target=self._read, daemon=True)
        self._reader.start()

    @property
    def text(self):
        return CONTROL.sub(b"", self._shown).decode(errors="replace")

    def wait_for(self, words):
        def shown():
            more = self._reader.is_alive()  # asked first: it may end behind the last words
            assert words in self.text or more, self.text
            return words in self.text

        wait_until(shown, f"the terminal shows {words!r}")

    def press(self, key):
        os.write(self._master, key)

    def hang_up(self):
        """Close the terminal: the kernel sends SIGHUP to the program."""
        if not self._gone.is_set():
            self._gone.set()
            self._reader.join()
            os.close(self._master)

    def _read(self):
        while not self._gone.is_set():
            if select.select([self._master], [], [], 0.05)[0]:
                try:
                    self._shown += os.read(self._master, 65536)
                except OSError:  # the program has ended
                    return
