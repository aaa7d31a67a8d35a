"""An AS5600 as its data sheet describes it: registers, pointer, magnet.

Only bytes go in and out, as on the wire, so that the same chip serves a Python bus object and real
bus calls that are redirected to it.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

__all__ = ["ADDRESS", "As5600Chip"]

ADDRESS = 0x36
_TURN = 4096
_HYSTERESIS = 10
_REGISTERS = 256
_STATUS, _RAW, _ANGLE, _AGC, _MAGNITUDE, _BURN = 0x0B, 0x0C, 0x0E, 0x1A, 0x1B, 0xFF
_ZPOS, _MPOS, _MANG = 0x01, 0x03, 0x05
_WRITABLE = range(0x01, 0x09)  # ZPOS, MPOS, MANG, CONF
# Set on the high byte of one of these, the pointer comes back to it after the low byte.
_HELD = (_RAW, _ANGLE, _MAGNITUDE)

# The field at the chip falls with the gap. 30 to 90 mT can be regulated; about 8 mT are noticed.
_FIELD_MT, _FIELD_GAP_MM, _FIELD_FALLS_MM = 44.0, 2.0, 1.6
_WEAK_MT, _STRONG_MT, _NOTICED_MT = 30.0, 90.0, 8.0
_AGC_MOST = 128  # at 3.3 V
_MAGNITUDE_REGULATED = 2000.0


@dataclass
class As5600Chip:
    """The chip with its magnet.

    Attributes
    ----------
    counts : callable
        From CLOCK_MONOTONIC (ns) to the magnet's angle in counts, unwrapped.
    magnet_gap_mm : float
        Between magnet and chip; ``inf`` for no magnet. 2 mm is right, below 0.9 mm the field is
        too strong, above 2.6 mm too weak, above 4.7 mm it is not noticed.
    burns : list of int
        What was written to register 0xFF: on a real chip each is for ever.
    writes : list of (int, bytes)
        All that was written beside the pointer: register and bytes.
    """

    counts: Callable[[int], float]
    magnet_gap_mm: float = _FIELD_GAP_MM
    burns: list[int] = field(default_factory=list)
    writes: list[tuple[int, bytes]] = field(default_factory=list)
    _pointer: int = 0
    _set: dict[int, int] = field(default_factory=dict)
    _was_high: bool = False

    def write(self, data: bytes) -> None:
        """Take a write: the pointer, then bytes for the registers from there on."""
        if not data:
            return
        self._pointer, values = data[0], data[1:]
        if not values:
            return
        self.writes.append((self._pointer, bytes(values)))
        for register, value in enumerate(values, self._pointer):
            if register == _BURN:
                self.burns.append(value)
            elif register in _WRITABLE:
                self._set[register] = value

    def read(self, count: int, now_ns: int) -> bytes:
        """Return bytes from the pointer on, as of one moment."""
        angle = self._raw(now_ns)
        values = self._registers(angle)
        given = bytearray()
        pointer = self._pointer
        while len(given) < count:
            if pointer in _HELD:
                given += bytes(values.get(register, 0) for register in (pointer, pointer + 1))
            else:
                given.append(values.get(pointer, 0))
                pointer = (pointer + 1) % _REGISTERS
        self._pointer = pointer
        return bytes(given[:count])

    def field_mt(self) -> float:
        """Return the magnet's field at the chip, millitesla."""
        return _FIELD_MT * math.exp((_FIELD_GAP_MM - self.magnet_gap_mm) / _FIELD_FALLS_MM)

    def _raw(self, now_ns: int) -> int:
        return round(self.counts(now_ns)) % _TURN

    def _registers(self, raw: int) -> dict[int, int]:
        strength = self.field_mt()
        detected = strength >= _NOTICED_MT
        weak, strong = strength < _WEAK_MT, strength > _STRONG_MT
        # The gain that brings any field to the same magnitude, from its least to its most.
        gain = (1 / strength if strength else math.inf) - 1 / _STRONG_MT
        share = gain / (1 / _WEAK_MT - 1 / _STRONG_MT)
        agc = round(_AGC_MOST * min(max(share, 0.0), 1.0))
        regulated = strength / _WEAK_MT if weak else strength / _STRONG_MT if strong else 1.0
        # Without a magnet it measures noise; a real chip's angle is then anything.
        values = dict(self._set)
        values[_STATUS] = detected << 5 | weak << 4 | strong << 3
        values[_AGC] = agc
        for register, value in (
            (_RAW, raw),
            (_ANGLE, self._angle(raw)),
            (_MAGNITUDE, min(round(_MAGNITUDE_REGULATED * regulated), _TURN - 1)),
        ):
            values[register], values[register + 1] = value >> 8, value & 0xFF
        return values

    def _angle(self, raw: int) -> int:
        """Return ANGLE: from zero position, scaled to the range, calm at the wrap."""
        zero, stop, span = (self._pair(register) for register in (_ZPOS, _MPOS, _MANG))
        turned = (raw - zero) % _TURN
        range_ = (stop - zero) % _TURN if stop else span
        if range_:
            return min(turned * _TURN // range_, _TURN - 1)
        # Over the wrap it stays at the end that it comes from for ten counts.
        if self._was_high and turned < _HYSTERESIS:
            return _TURN - 1
        if not self._was_high and turned >= _TURN - _HYSTERESIS:
            return 0
        self._was_high = turned >= _TURN // 2
        return turned

    def _pair(self, register: int) -> int:
        return (self._set.get(register, 0) << 8 | self._set.get(register + 1, 0)) & (_TURN - 1)
