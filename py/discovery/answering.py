from __future__ import annotations
from dataclasses import dataclass
@dataclass(frozen=True, eq=False)
class Step:
    choice: object
    ranked: tuple
    tried: tuple
    before: object
@dataclass(frozen=True, eq=False)
class Found:
    base: object
    last: object
    steps: tuple
    screens: tuple
def answer(*a): raise NotImplementedError
