"""The project's fuzz suite, `make fuzz`: inputs that nobody means well, one file per class of input, one runner.

A class is a module with

- `make_corpus(folder)`: what its inputs are made from, written once;
- `made(corpus)`: inputs that were thought of, or what makes one; `cases(corpus)`: a hypothesis strategy for all others;
- `prepare(corpus)`, then `examine(case, notes)`: try one input on everything that reads it.

Three findings count: an exception that is not one of ours or a text `Traceback`, a process that ended or gave no sign
of life in time, a wrong thing called sound.
"""

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Case:
    """One input: files by name, and what else it takes to try it again, all texts."""

    files: dict[str, bytes]
    facts: dict[str, str] = field(default_factory=dict)
