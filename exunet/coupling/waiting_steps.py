"""Steps of a coupling that count, on their way into the books."""

from __future__ import annotations

from exunet.coupling.books import Books, Ended

# Steps that wait for the books: to take one in takes as long as all else that is done in a step, many at once
# hardly longer.
_WAITING = 256


class WaitingSteps:
    """Those that are not in the books yet."""

    def __init__(self) -> None:
        self._ended: list[Ended] = []

    def add(self, step: Ended, books: Books) -> None:
        """Let a step wait, or write all that wait into the books."""
        self._ended.append(step)
        if len(self._ended) >= _WAITING:
            self.write(books)

    def write(self, books: Books) -> None:
        """Take the steps that wait into the books."""
        books.add(self._ended)
        self.forget()

    def forget(self) -> None:
        """Drop those that wait."""
        self._ended.clear()
