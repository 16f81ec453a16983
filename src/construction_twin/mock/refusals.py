"""Why replies do not count, told when that begins and when it ends, not with every reply. Pure, standard library only."""

from __future__ import annotations


class ReplyRefusals:
    """The refused replies of a controller.

    Attributes:
        last: Why the last one did not count, one sentence; "" before the first.
        present: The same while replies are refused; "" when so many have counted since that it is over.
        since_valid: The same, of those since the last reply that counted.
        news: Sentences for the log; whoever writes them empties the list.
    """

    def __init__(self, recovery: int) -> None:
        self._recovery = recovery
        self.last = self.present = self.since_valid = ""
        self.news: list[str] = []
        self._reported: set[str] = set()
        self._refused = self._valid = 0

    def begin_session(self) -> None:
        """Forget what belongs to the session before; `last` stays for people."""
        self.present = self.since_valid = ""
        self._reported.clear()
        self._refused = self._valid = 0

    def refuse(self, kind: str, sentence: str) -> None:
        """Take note of a reply that does not count; the first of its kind is told at once."""
        self.last = self.present = self.since_valid = sentence
        self._refused += 1
        self._valid = 0
        if kind not in self._reported:
            self._reported.add(kind)
            self.news.append(f"reply refused: {sentence}")

    def accept(self) -> None:
        """Take note of a reply that counts."""
        if not self.present:
            return
        self.since_valid = ""
        self._valid += 1
        if self._valid >= self._recovery:
            self.news.append(f"replies count again; {self._refused} were refused, the last one because {self.last}")
            self.begin_session()
