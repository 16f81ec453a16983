"""Reads telegrams that differ from an earlier one only in their numbers, without an XML parser.

A controller sends the same text every 4 ms with other numbers in it. Where one of these was read as XML, the next one
of the same shape needs no parser: between equal texts, values without markup stand for the same attributes. Standard
library only.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from construction_twin.core.udp import MAX_TELEGRAM

#: What values may consist of, all of them together, so that they cannot change what is around them.
_is_plain = re.compile(rb"[-+.0-9A-Za-z]*").fullmatch
#: Whole numbers that fit into 64 bits whatever their digits.
is_count = re.compile(rb"[0-9]{1,19}").fullmatch
_TAG = re.compile(rb"<([A-Za-z]\w*)")
_ATTRIBUTE = re.compile(rb"\s([A-Za-z]\w*)=$").search
#: The end of a telegram, behind the last attribute.
_END = re.compile(rb"([^\"]*<IPOC>)[0-9]+(</IPOC></[A-Za-z]+>\s*)").fullmatch


class TelegramShape:
    """One telegram's shape; made by `of`.

    Args:
        texts: What stands before each value.
        end: What stands before and behind the number in IPOC, which is the last element.
        places: Which values are read, in order.
    """

    def __init__(self, texts: list[bytes], end: tuple[bytes, bytes], places: list[int]):
        self._texts = texts
        self._before, self._behind = end
        self._places = places

    @classmethod
    def of(cls, data: bytes, wanted: Sequence[tuple[str, str]]) -> TelegramShape | None:
        """Return the shape of a telegram that was read as XML without complaint.

        Args:
            wanted: Element and attribute of each value to be read.

        Returns:
            None where the text does not show at once what its values stand for: a wanted one is missing or there twice, IPOC is not
            the last element, or something else stands in quotation marks or apostrophes.
        """
        if b"'" in data:
            return None
        *texts, last = data.split(b'"')[0::2]
        end = _END(last)
        keys, tag = [], ""
        for text in texts:
            for found in _TAG.finditer(text):
                tag = found[1].decode()
            attribute = _ATTRIBUTE(text)
            if attribute is None:
                return None
            keys.append((tag, attribute[1].decode()))
        if end is None or any(keys.count(key) != 1 for key in wanted):
            return None
        return cls(texts, (end[1], end[2]), [keys.index(key) for key in wanted])

    def read(self, data: bytes) -> tuple[int, list[bytes]] | None:
        """Return IPOC and the wanted values of a telegram; None when it has another shape."""
        parts = data.split(b'"')
        texts, values = parts[0::2], parts[1::2]
        last = texts.pop()
        if texts != self._texts or not _is_plain(b"".join(values)) or len(data) > MAX_TELEGRAM:
            return None
        if not (last.startswith(self._before) and last.endswith(self._behind)):
            return None
        ipoc = last[len(self._before) : len(last) - len(self._behind)]
        if not is_count(ipoc):
            return None
        return int(ipoc), [values[place] for place in self._places]
