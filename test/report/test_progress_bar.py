"""Progress bars: words stand above them, and the time left is stated once."""

import sys

from rich.progress import TimeRemainingColumn

from rotcal_ros.report.terminal.console import progress_bar, say


def test_words_go_above_the_bar_and_not_through_it(monkeypatch):
    written = []

    class Terminal:
        encoding = "utf-8"

        def write(self, text):
            written.append(text)

        def flush(self):
            pass

        def isatty(self):
            return True

        def fileno(self):
            return 2

    monkeypatch.setattr(sys, "stderr", Terminal())
    monkeypatch.setenv("TERM", "xterm")
    with progress_bar() as bar:
        bar.add_task("solving", total=2)
        assert sys.stderr is not bar.console.file  # rich stands between
        say("one bag is bad")
        bar.refresh()
    text = "".join(written)
    before, _, after = text.partition("one bag is bad")
    assert before.endswith(("\x1b[2K", "\r", "\x1b[1A\x1b[2K"))  # the line of the bar was cleared
    assert "solving" in after


def test_the_planner_tells_the_time_left_alone():
    def columns(bar):
        return [type(column) for column in bar.columns]

    assert TimeRemainingColumn in columns(progress_bar())
    assert TimeRemainingColumn not in columns(progress_bar(time_left=False))
