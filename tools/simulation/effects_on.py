"""The active effects: they are imported and called here, and their costs are counted here."""

import importlib
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from counterlight.tools.simulation.needs import Need


@dataclass
class Costs:
    """Processor seconds, entries and energy, by effect."""

    seconds: dict[str, float]
    entries: dict[str, int]
    energy: dict[str, float]


class EffectsOn:
    """Active effects by name. Calls are timed; processor seconds, entries and energy are summed for the report.

    Energy is radiance, summed over camera pixels and channels under a white projector picture, that an effect adds,
    removes or moves to other pixels.
    """

    def __init__(self, needs: Mapping[str, Need]) -> None:
        names = [name for name, need in needs.items() if need.on]
        self._modules: dict[str, ModuleType] = {
            name: importlib.import_module(f"counterlight.tools.simulation.effects.{name}") for name in names
        }
        self._calling: list[str] = []
        self.forget_costs()

    def forget_costs(self) -> None:
        self.seconds = dict.fromkeys(self._modules, 0.0)
        self.entries = dict.fromkeys(self._modules, 0)
        self.energy = dict.fromkeys(self._modules, 0.0)

    @property
    def costs(self) -> Costs:
        return Costs(self.seconds, self.entries, self.energy)

    def add(self, costs: Costs) -> None:
        """Add costs of another process."""
        for name in self._modules:
            self.seconds[name] += costs.seconds[name]
            self.account(name, costs.energy[name], costs.entries[name])

    def __contains__(self, effect: str) -> bool:
        return effect in self._modules

    def call(self, effect: str, function: str, *arguments: Any) -> Any:
        """Call a function of an effect's module and charge its time to the effect."""
        return self.timed(effect, getattr(self._modules[effect], function), *arguments)

    def timed(self, effect: str, function: Callable[..., Any], *arguments: Any) -> Any:
        """Call a function and charge its time to an effect. A nested call charges only the inner effect."""
        start = time.process_time()
        self._calling.append(effect)
        try:
            return function(*arguments)
        finally:
            self._calling.pop()
            spent = time.process_time() - start
            self.seconds[effect] += spent
            if self._calling:
                self.seconds[self._calling[-1]] -= spent

    def whole(self, effect: str, function: Callable[..., Any], *arguments: Any) -> Any:
        """Call a function and charge its time to an effect, with the time of the effects that it calls."""
        seconds, start = self.seconds, time.process_time()
        self.seconds = dict(seconds)
        result = function(*arguments)
        self.seconds = seconds | {effect: seconds[effect] + time.process_time() - start}
        return result

    def having(self, function: str) -> list[str]:
        """Returns the active effects that define this function, in the order of needs.py."""
        return [name for name, module in self._modules.items() if hasattr(module, function)]

    def account(self, effect: str, energy: float | np.floating[Any], entries: int = 0) -> None:
        self.energy[effect] += float(energy)
        self.entries[effect] += entries
