"""How invitations and entries of devices are encrypted: AES-256-GCM, keys from HKDF-SHA256 and scrypt, all of `cryptography`. Pure.

Three secrets take part, in three places: the console's own (its folder), the cookie's (the device), and the PIN (a person's head).
"""

from __future__ import annotations

from dataclasses import dataclass

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDF
from cryptography.hazmat.primitives.kdf.scrypt import Scrypt

#: Bytes of a key, of each of the console's and the cookie's secrets and of a token, of scrypt's salt, and of a nonce.
KEY, SALT, NONCE = 32, 16, 12


@dataclass(frozen=True)
class Cost:
    """What one try of a PIN costs, with scrypt: 128 MB, and about 0.3 s of one core of 2024.

    Attributes:
        n: A power of 2.
        r, p: Memory is 128 `n` `r` bytes, time goes with `n` `r` `p`.
    """

    n: int = 2**17
    r: int = 8
    p: int = 1


def key_of_token(own: bytes, token: bytes) -> bytes:
    """Return the key of an invitation; `own` is the console's secret."""
    return _key(own, "invitation", token)


def key_of_device(own: bytes, cookie: bytes, device: str) -> bytes:
    """Return the key of what a device may have without a PIN."""
    return _key(own, f"device {device}", cookie)


def key_of_pin(own: bytes, cookie: bytes, device: str, pin: str, salt: bytes, cost: Cost) -> bytes:
    """Return the key of what a device may have with the PIN only."""
    stretched = Scrypt(salt=salt, length=KEY, n=cost.n, r=cost.r, p=cost.p).derive(pin.encode())
    return _key(own, f"account {device}", stretched + cookie)


def _key(own: bytes, purpose: str, secret: bytes) -> bytes:
    return HKDF(
        algorithm=SHA256(), length=KEY, salt=own, info=f"construction_twin pairing 1: {purpose}".encode()
    ).derive(secret)


def seal(key: bytes, nonce: bytes, text: str, about: str) -> bytes:
    """Return a text encrypted.

    Args:
        nonce: Random, a new one each time.
        about: What it belongs to: with another text it cannot be opened.
    """
    return nonce + AESGCM(key).encrypt(nonce, text.encode(), about.encode())


def unseal(key: bytes, sealed: bytes, about: str) -> str | None:
    """Return the text; None when key or `about` is another one, or a byte has changed."""
    try:
        return AESGCM(key).decrypt(sealed[:NONCE], sealed[NONCE:], about.encode()).decode()
    except (InvalidTag, ValueError):
        return None
