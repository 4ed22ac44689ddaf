"""Work that costs nothing, for processes of several devices: they import this file and no solver."""

import os
import time

from fishmj.base.cores import usable_cores
from fishmj.base.errors import LogError


def squared(waiting, device, go_on, *, room=1, meet=None):
    """Squares of numbers, `room` of them in hand at a time; said with the process, its cores, and what it had in hand.

    meet: a folder; a process waits there until another has come, too.
    """
    held = []
    while held or waiting:
        while len(held) < room and waiting:
            held.append(waiting.popleft())
        if meet is not None:
            (meet / str(os.getpid())).touch()
            while len(list(meet.iterdir())) < 2:
                time.sleep(0.01)
        go_on(float(len(held)))
        key, most = held.pop(0), len(held) + 1
        yield key, key**2, os.getpid(), usable_cores(), most


def fails(waiting, device, go_on, *, how):
    key = waiting.popleft()
    if how == "error":
        raise LogError(f"key {key}: no swim")
    if how == "fault":
        raise ZeroDivisionError("a fault")
    if how == "dies":
        os._exit(3)
    yield lambda: key


def steered(waiting, device, go_on, *, brain):
    while waiting:
        yield waiting.popleft() * brain.gain


def rests(waiting, device, go_on, *, diary):
    (diary / f"{os.getpid()}.pid").touch()
    time.sleep(300)
    yield waiting.popleft()
