"""Foxglove's WebSocket protocol, as far as a viewer that only looks needs it.

A channel is a topic with its schema; a client subscribes to channels and reads parameters. Setting
one asks; services and publishing by clients are not offered. See
https://github.com/foxglove/ws-protocol.
"""

import asyncio
import contextlib
import json
import struct
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from math import isfinite
from typing import Any

from steerd.daemon.ipc.requests import LIVE, format_setting
from steerd.daemon.process.secret_server import ServerConnection, converse

PROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")
WORDS_MAX = 1 << 16
"""Longest message of a client [bytes]; a subscription to all channels is some 2 kB."""
_BACKLOG = 1024  # messages that wait for a slow client; the oldest give way
_DATA = struct.Struct("<BIQ")
_MESSAGE_DATA = 1
_ODD = (ValueError, KeyError, TypeError, AttributeError, RecursionError)
"""What a client's message that is none may raise."""

Value = float | str


Channel = Mapping[str, str]
"""A topic as it is advertised, but for its number; a schema that is binary stands as base64."""


@dataclass(eq=False)
class _Client:
    """One who looks: subscription by channel, parameters that are followed, what waits."""

    subscribed: dict[int, int] = field(default_factory=dict)
    followed: set[str] = field(default_factory=set)
    waiting: deque[str | bytes] = field(default_factory=lambda: deque(maxlen=_BACKLOG))
    ready: asyncio.Event = field(default_factory=asyncio.Event)

    def give(self, message: str | bytes) -> None:
        self.waiting.append(message)
        self.ready.set()


class ViewServer:
    """Channels, parameters and clients of one car; setting a parameter changes nothing here.

    Where the run allows it (`--view-sets`), setting a live one hands the run's terminal a text for
    it (`ask`). Its new value comes back from the car, if it is accepted.
    """

    def __init__(
        self,
        name: str,
        channels: Iterable[Channel],
        values: Mapping[str, Value],
        ask: Callable[[bytes], object] | None = None,
    ) -> None:
        self._name, self._values, self._ask = name, dict(values), ask
        self._channels = list(channels)
        self._ids = {channel["topic"]: number for number, channel in enumerate(self._channels, 1)}
        self._clients: set[_Client] = set()

    def get(self, names: Iterable[str]) -> dict[str, Value]:
        """Parameters by name; all where none is named."""
        wanted = list(names) or list(self._values)
        return {n: self._values[n] for n in wanted if n in self._values}

    def set(self, wanted: Mapping[str, object]) -> dict[str, Value]:
        """Ask for live parameters; a car file does not change during a drive. What they are now."""
        for full, value in wanted.items():
            group, _, name = full.partition(".")
            if self._ask is None or group != "live" or name not in LIVE:
                continue
            if isinstance(value, int | float) and not isinstance(value, bool):
                self._ask(format_setting(name, float(value)).encode())
        return self.get(wanted)

    def log(self, topic: str, data: bytes, log_ns: int) -> None:
        """Send a message to those who subscribed to its channel."""
        channel = self._ids[topic]
        for client in self._clients:
            number = client.subscribed.get(channel)
            if number is not None:
                client.give(_DATA.pack(_MESSAGE_DATA, number, log_ns) + data)

    def show(self, values: Mapping[str, Value]) -> dict[str, Value]:
        """Take in parameters; those that changed, which are sent to those who follow them."""
        changed = {n: v for n, v in values.items() if self._values.get(n) != v}
        self._values |= changed
        for client in self._clients:
            followed = {n: v for n, v in changed.items() if n in client.followed}
            if followed:
                client.give(_encode_values(followed))
        return changed

    async def talk(self, connection: ServerConnection) -> None:
        """Serve one client until it leaves."""
        client = _Client()
        can = ["parameters", "parametersSubscribe"]
        about = {"name": self._name, "capabilities": can, "supportedEncodings": [], "metadata": {}}
        client.give(_encode("serverInfo", **about))
        offered = [{"id": self._ids[channel["topic"]], **channel} for channel in self._channels]
        client.give(_encode("advertise", channels=offered))
        self._clients.add(client)
        try:
            await converse(connection, _send(connection, client), partial(self._take, client))
        finally:
            self._clients.discard(client)

    def _take(self, client: _Client, words: str) -> None:
        with contextlib.suppress(*_ODD):
            self._obey(client, json.loads(words))

    def _obey(self, client: _Client, said: Any) -> None:
        match said["op"]:
            case "subscribe":
                for each in said["subscriptions"]:
                    client.subscribed[int(each["channelId"])] = int(each["id"]) & 0xFFFFFFFF
            case "unsubscribe":
                ended = set(said["subscriptionIds"])
                kept = {c: n for c, n in client.subscribed.items() if n not in ended}
                client.subscribed = kept
            case "getParameters":
                values = self.get(map(str, said["parameterNames"]))
                client.give(_encode_values(values, said.get("id")))
            case "setParameters":
                wanted = {str(p["name"]): p.get("value") for p in said["parameters"]}
                client.give(_encode_values(self.set(wanted), said.get("id")))
            case "subscribeParameterUpdates":
                names = self.get(map(str, said["parameterNames"]))
                client.followed |= {*names, *map(str, said["parameterNames"])}
            case "unsubscribeParameterUpdates":
                client.followed -= set(map(str, said["parameterNames"]))


async def _send(connection: ServerConnection, client: _Client) -> None:
    while True:
        await client.ready.wait()
        client.ready.clear()
        while client.waiting:
            await connection.send(client.waiting.popleft())


def _encode(op: str, **said: Any) -> str:
    return json.dumps({"op": op, **said}, allow_nan=False)


def _encode_values(values: Mapping[str, Value], answer_to: object = None) -> str:
    """Parameters; a number that is none is left without a value."""
    parameters: list[dict[str, object]] = []
    for name, value in values.items():
        if isinstance(value, str):
            parameters.append({"name": name, "value": value})
        elif isfinite(value):
            parameters.append({"name": name, "value": value, "type": "float64"})
    answered = {"id": str(answer_to)} if answer_to is not None else {}
    return _encode("parameterValues", parameters=parameters, **answered)
