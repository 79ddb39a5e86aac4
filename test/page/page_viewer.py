"""Looking at the page of a live cell: as a program, and in a real browser."""

import json
import re
import urllib.error
import urllib.request
from threading import Thread

from live_cell import wait_until

from rotcal_ros.foundation.machine_load import load_scaled_timeout


def english(sent):
    """Return the text of what the page is sent: a text, or a template and what stands in it."""
    return sent if isinstance(sent, str) else sent[0].format(*map(english, sent[1:]))


def address(live, name="operator_page"):
    """Return where a page is served, once it is."""
    wait_until(lambda: re.search(r"page: (\S+)", live.log(name)), "the page is served")
    return re.search(r"page: (\S+)", live.log(name))[1]


class Viewer:
    """Holds what the page has sent so far."""

    def __init__(self, url):
        self.url, self.state, self.names = url, {}, []
        Thread(target=self._read, daemon=True).start()
        self.wait(lambda s: s, "a state")

    def wait(self, condition, what):
        wait_until(lambda: condition(self.state), f"the page shows {what}")
        return self.state

    def wait_for(self, kind):
        return self.wait(lambda s: s["now"]["kind"] == kind, kind)

    def post(self, what, **values):
        """Ask as the page does; return status and answer."""
        headers = {
            "Origin": self.url,
            "X-Rotcal-Token": self.state["token"],
            "Content-Type": "application/json",
        }
        request = urllib.request.Request(
            f"{self.url}/{what}", json.dumps(values).encode(), headers, method="POST"
        )
        try:
            with urllib.request.urlopen(request, timeout=load_scaled_timeout(60)) as answer:
                return answer.status, json.loads(answer.read())
        except urllib.error.HTTPError as error:
            return error.code, json.loads(error.read())

    def _read(self):
        name = ""
        with urllib.request.urlopen(
            f"{self.url}/events", timeout=load_scaled_timeout(60)
        ) as stream:
            for line in stream:
                field, _, text = line.decode().strip().partition(": ")
                if field == "event":
                    name = text
                    self.names.append(name)
                elif field == "data":
                    self.state = {**self.state, **json.loads(text)}
