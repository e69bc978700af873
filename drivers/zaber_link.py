"""Questions and answers with one axis of a Zaber device: ids, checksums, and a few tries where noise swallowed one."""

import logging
import time

from drivers.errors import DeviceBusyError, DeviceProtocolError, DeviceTimeoutError, OutOfTravelError
from drivers.serial_port import SerialPort, deadline_after
from drivers.zaber_protocol import REJECTIONS, ZaberMessage, read_message, write_command

ANSWER_S = 0.5
TRIES = 4
LAST_ID = 99
AGAIN_S = 0.05

log = logging.getLogger(__name__)


class ZaberLink:
    """The conversation with one axis of one device. Alerts and infos are logged and otherwise ignored."""

    def __init__(self, port: SerialPort, *, device: int, axis: int) -> None:
        self._port = port
        self._device = device
        self._axis = axis
        self._id = 0

    def ask(self, words: str, *, of_axis: bool = True) -> ZaberMessage:
        """Send ``words`` and return the reply, trying again when none comes: only for what may be said twice.

        Raises
        ------
        OutOfTravelError, DeviceBusyError, DeviceProtocolError
            When the device rejects the command.
        DeviceTimeoutError
            When it stays silent.
        """
        with self._port.transaction():
            for _ in range(TRIES):
                try:
                    return self.say(words, of_axis=of_axis)
                except DeviceTimeoutError as error:
                    silence = error
            raise silence

    def say(self, words: str, *, of_axis: bool = True) -> ZaberMessage:
        """As :meth:`ask`, but once: for a movement, which a second command would interrupt.

        Only a rejection with AGAIN, after which nothing has happened, is answered by saying it again a moment later.
        """
        for attempt in range(1, TRIES + 1):
            with self._port.transaction():
                self._id = self._id % LAST_ID + 1
                axis = self._axis if of_axis else 0
                self._port.write(write_command(words, device=self._device, axis=axis, message_id=self._id))
                reply = self._reply_to(words)
            if reply.accepted:
                return reply
            if reply.data != "AGAIN" or attempt == TRIES:
                raise self._rejection(words, reply.data)
            time.sleep(AGAIN_S)
        raise AssertionError("unreachable: the last attempt returns or raises")

    def _reply_to(self, words: str) -> ZaberMessage:
        question = f"the reply of device {self._device} to {words or 'a status poll'!r}"
        deadline_s = deadline_after(ANSWER_S)
        while True:
            line = self._port.read_until(b"\n", deadline_s=deadline_s, question=question)
            message = read_message(line)
            if message is None:
                log.warning("%s: not understood: %r", self._port.device, line)
            elif message.kind != "@":
                log.info("%s: device %d says %s", self._port.device, message.device, message.data)
            elif message.device == self._device and message.id == f"{self._id:02d}":
                return message

    def _rejection(self, words: str, reason: str) -> DeviceProtocolError | DeviceBusyError | OutOfTravelError:
        what = repr(words) if words else "a status poll"
        said = f"{self._port.device}: {what} was rejected with {reason}: {REJECTIONS.get(reason, 'see the manual')}"
        if reason == "BADDATA" and words.startswith("move"):
            return OutOfTravelError(said)
        return DeviceBusyError(said) if reason in ("STATUSBUSY", "AGAIN") else DeviceProtocolError(said)
