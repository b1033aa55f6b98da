"""General purpose registers and digital outputs, which programs and RTDE clients share."""

from collections.abc import Mapping

from omniman_ros.simulation.ur.rtde_fields import BOOLS, INPUTS, OUTPUTS, REGISTERS, Number, Value
from omniman_ros.simulation.ur.urscript.errors import ScriptRuntimeError

#: Groups of digital outputs: first bit and number of bits of actual_digital_output_bits
DIGITAL = {"standard": (0, 8), "configurable": (8, 8), "tool": (16, 2)}
GROUPED = 64  #: First bit that RTDE transfers by itself; lower ones are in groups of 32


class Registers:
    """All registers and digital outputs, initially zero."""

    def __init__(self) -> None:
        #: Value of each RTDE field of this kind
        self.values: dict[str, Value] = {
            name: False if kind == "BOOL" else 0.0 if kind == "DOUBLE" else 0
            for name, kind in (OUTPUTS | INPUTS).items()
            if "_register" in name
        }
        self.digital_outputs = 0  #: Bits, see DIGITAL

    def write_inputs(self, values: Mapping[str, Value]) -> None:
        """Store inputs that arrived in one package of a client."""
        self.values.update({name: v for name, v in values.items() if name in self.values})
        for group, (first, count) in DIGITAL.items():
            mask = values.get(f"{group}_digital_output_mask", 0)
            bits = values.get(f"{group}_digital_output", 0)
            if isinstance(mask, int) and isinstance(bits, int):
                mask &= (1 << count) - 1
                self.digital_outputs &= ~(mask << first)
                self.digital_outputs |= (bits & mask) << first

    def read(self, side: str, kind: str, index: int) -> Number:
        """Return a register ("int", "double" or "bool"); none raises a ScriptRuntimeError."""
        if kind == "bool" and 0 <= index < GROUPED:
            return bool(self._number(_group(side, index)) >> index % 32 & 1)
        return self.values_number(_name(side, kind, index))

    def write(self, side: str, kind: str, index: int, value: Number) -> None:
        """Set a register; arguments and errors as in :meth:`read`."""
        if kind == "bool" and 0 <= index < GROUPED:
            name = _group(side, index)
            bit = 1 << index % 32
            bits = self._number(name)
            self.values[name] = bits | bit if value else bits & ~bit
            return
        name = _name(side, kind, index)
        if kind == "double":
            self.values[name] = float(value)
        elif kind == "bool":
            self.values[name] = bool(value)
        else:
            # Wraps around like a register of 32 bits.
            self.values[name] = (int(value) + (1 << 31)) % (1 << 32) - (1 << 31)

    def _number(self, name: str) -> int:
        return int(self.values_number(name))

    def values_number(self, name: str) -> Number:
        """Return the value of a field that is one number."""
        value = self.values[name]
        assert isinstance(value, (int, float))
        return value


def _group(side: str, index: int) -> str:
    first = index // 32 * 32
    return f"{side}_bit_registers{first}_to_{first + 31}"


def _name(side: str, kind: str, index: int) -> str:
    numbers = BOOLS if kind == "bool" else range(REGISTERS)
    if kind not in ("int", "double", "bool") or index not in numbers:
        raise ScriptRuntimeError(f"there is no {side} register {kind} {index}")
    return f"{side}_{'bit' if kind == 'bool' else kind}_register_{index}"
