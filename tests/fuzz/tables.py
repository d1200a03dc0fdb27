"""Damaged files of every kind other than a room's: settings, scenes, responses, meshes, pictures, arrays, tables."""

from pathlib import Path

import numpy as np

from tests.fuzz.tally import Trial
from tests.fuzz.warden import Case, FileCampaign
from tests.mutants import mutant
from tests.samples import samples


class Tables(FileCampaign):
    """A mutant of one of the samples is read, or refused in one line."""

    name, count = "tables", 800
    purpose = "damaged TOML, npz, npy, EXR, PNG, JPEG, DNG, OBJ and CSV"

    def furnish(self, folder: Path) -> None: ...

    def open(self, folder: Path) -> None:
        self._folder = folder
        originals = folder / "originals"
        originals.mkdir(exist_ok=True)
        self._samples = samples(originals)
        self._names = sorted(self._samples)

    def draw(self, rng: np.random.Generator) -> Case:
        name = self._names[rng.integers(len(self._names))]
        return Case({name: mutant(self._samples[name].content, name, rng)}, name)

    def judge(self, case: Case) -> Trial:
        ((name, content),) = case.files.items()
        return Trial(self._samples[name].outcome(self._folder / name, content))
