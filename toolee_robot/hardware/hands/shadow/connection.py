"""A websocket with the errors of a hand's: it cannot be opened, or is gone."""

from __future__ import annotations

import time

from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidURI
from websockets.sync.client import connect

from toolee_robot.errors import ConfigError, NoAnswerError

OPEN_TIME, CLOSE_TIME = 3.0, 0.3
"""Longest time for connecting, and for taking leave [s]."""
QUEUE = 64
"""Messages that wait here at most; others wait at the sender's."""


class Connection:
    """The websocket of a hand's rosbridge; one thread may use it.

    Args:
        url: Its address, such as `ws://127.0.0.1:9090`.

    Attributes:
        url: Its address.

    Raises:
        ConfigError: It is no such address.
        NoAnswerError: Nobody answers there, or no rosbridge does.
    """

    def __init__(self, url: str) -> None:
        self.url = url
        if not url.startswith(("ws://", "wss://")):
            raise ConfigError(f"hand.port is {url!r}: give ws://HOST:9090, a rosbridge", code="config.hand_port")
        try:
            self._socket = connect(
                url, compression=None, open_timeout=OPEN_TIME, close_timeout=CLOSE_TIME, ping_interval=None,
                max_queue=QUEUE, proxy=None,
            )  # fmt: skip
        except InvalidURI as error:
            raise ConfigError(f"hand.port is {url!r}: give ws://HOST:9090", code="config.hand_port") from error
        except (OSError, TimeoutError, InvalidHandshake, EOFError) as error:
            message = f"no rosbridge answers at {url}: {error}; check hand.port, the network, and that"
            raise NoAnswerError(
                f"{message} rosbridge_websocket runs beside the hand", code="no_answer.hand_port"
            ) from error

    def close(self) -> None:
        """Take leave; the hand stays as it is."""
        self._socket.close()

    def send(self, text: str) -> None:
        """Send a message.

        Args:
            text: The message.

        Raises:
            NoAnswerError: The connection is gone.
        """
        try:
            self._socket.send(text)
        except (ConnectionClosed, OSError) as error:
            raise self._gone(error) from error

    def receive(self, within: float) -> list[bytes]:
        """Return what has come, all of it; wait for the first message.

        Args:
            within: For how long at most [s].

        Returns:
            The messages; none if none came.

        Raises:
            NoAnswerError: The connection is gone.
        """
        found: list[bytes] = []
        end = time.monotonic() + within
        try:
            while len(found) < QUEUE:
                left = 0.0 if found else max(0.0, end - time.monotonic())
                data = self._socket.recv(left, decode=False)
                found.append(data if isinstance(data, bytes) else data.encode())
        except TimeoutError:
            pass
        except (ConnectionClosed, OSError) as error:
            raise self._gone(error) from error
        return found

    def _gone(self, error: Exception) -> NoAnswerError:
        message = f"the connection to the hand at {self.url} is gone ({error}): see that rosbridge and the hand run,"
        return NoAnswerError(f"{message} then start again", code="no_answer.hand_unplugged")
