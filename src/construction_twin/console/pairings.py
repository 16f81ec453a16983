"""The folder of a console's pairings: invitations that `twin pair` makes, and an entry per device that was paired with one.

It is the only state that a console keeps. Two programs use it at once, so each change is made under a lock of the whole folder, and
is on the disk before it is answered. What can be opened with the folder alone is nothing: see `sealing.py`.

    secret                      the console's own, made with the folder
    invitations/<hash>.json     by SHA-256 of the token; taken away by its use
    devices/<device>.json       passwords of the person's account and of the one for devices, encrypted; wrong PINs, counted
"""

from __future__ import annotations

import base64
import contextlib
import fcntl
import hashlib
import json
import os
import secrets
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from construction_twin.console.paired import DeviceCookie, PairingError, no_invitation
from construction_twin.console.pairings_folder import DEVICES, INVITATIONS, check_pairings_folder
from construction_twin.console.pin import refusal
from construction_twin.console.sealing import (
    KEY,
    NONCE,
    SALT,
    Cost,
    key_of_device,
    key_of_pin,
    key_of_token,
    seal,
    unseal,
)
from construction_twin.core.errors import ConfigurationError, ConstructionTwinError
from construction_twin.core.sentences import Sentence

#: An invitation is good for so long [s]; one made so far in the future was made by another clock [s].
INVITED_S, _AHEAD_S = 300.0, 5.0
#: Wrong PINs one after the other that end what a device may have with a PIN.
MOST_WRONG = 5
_VERSION = 1


@dataclass(frozen=True)
class Person:
    """Whose device it becomes: two accounts of the broker.

    Attributes:
        account, device_account: With a PIN, and without one.
    """

    account: str
    device_account: str


@dataclass(frozen=True)
class Invitation:
    """An invitation as it stands on the disk.

    Attributes:
        made, expires: Seconds since 1970.
        sealed: Both passwords, in base64.
    """

    account: str
    device_account: str
    made: float
    expires: float
    sealed: str


@dataclass(frozen=True)
class Device:
    """A paired device as it stands on the disk.

    Attributes:
        device: By which it is found.
        number: By which people call it; never given twice.
        invitation: Hash of the token that it was paired with.
        address: From which it was paired.
        paired, used: Time of the pairing, and of the last login with the PIN; 0: none yet. Seconds since 1970.
        wrong: PINs that were tried since.
        salt: Of the PIN's key, in base64.
        pin_sealed: Password of `account`, in base64; "" once too many PINs were wrong.
        device_sealed: Password of `device_account`, in base64.
    """

    device: str
    number: int
    account: str
    device_account: str
    invitation: str
    address: str
    paired: float
    salt: str
    pin_sealed: str
    device_sealed: str
    used: float = 0.0
    wrong: int = 0

    @property
    def has_pin(self) -> bool:
        """Whether a PIN may still be tried."""
        return bool(self.pin_sealed) and self.wrong < MOST_WRONG

    @property
    def left(self) -> int:
        """How many PINs may still be tried."""
        return MOST_WRONG - self.wrong if self.has_pin else 0


_Kept = TypeVar("_Kept", Invitation, Device)


class Pairings:
    """The pairings of one console.

    Args:
        folder: Made if it is not there. Nobody else may read it.
        now: Returns the time [s since 1970].
        cost: What one try of a PIN costs; the same for all that use the folder.

    Attributes:
        folder: As given.

    Raises:
        ConfigurationError: When the folder cannot be used, as `check_pairings_folder` says.
    """

    def __init__(self, folder: Path, now: Callable[[], float], cost: Cost | None = None):
        self.folder, self._now, self._cost = folder, now, cost or Cost()
        self._invitations, self._devices = folder / INVITATIONS, folder / DEVICES
        self._secret = folder / "secret"
        check_pairings_folder(folder)
        try:
            for each in (folder, self._invitations, self._devices):
                each.mkdir(mode=0o700, parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigurationError("--pairings", str(folder), Sentence("expected.pairings.folder")) from error
        with self._locked():
            if not self._secret.exists():
                _write_durable(self._secret, secrets.token_bytes(KEY).hex())

    # -- invitations

    def invite(self, person: Person, password: str, device_password: str) -> str:
        """Make an invitation; return its token, which stands nowhere else.

        Args:
            password, device_password: Of both accounts.
        """
        token, now = secrets.token_urlsafe(KEY), self._now()
        with self._locked():
            self._tidy(now)
            made = Invitation(person.account, person.device_account, now, now + INVITED_S, "")
            about = _about_invitation(made)
            text = json.dumps({"account": password, "device": device_password})
            sealed = seal(key_of_token(self._own(), token.encode()), secrets.token_bytes(NONCE), text, about)
            self._write(self._invitations / f"{hash_of(token)}.json", replace(made, sealed=_text(sealed)))
        return token

    def is_invited(self, hashed: str) -> bool:
        """Return whether there is an invitation whose token has this hash, and it is not too old."""
        found = self._invitation(hashed)
        return found is not None and self._is_good(found)

    def paired_with(self, hashed: str) -> Device | None:
        """Return the device for which the invitation of that hash was used; one that is being made is waited for."""
        with self._locked():
            return next((each for each in self.devices() if each.invitation == hashed), None)

    def withdraw(self, hashed: str) -> None:
        """Take an invitation away; nothing happens where it was used."""
        with self._locked():
            _remove(self._invitations / f"{hashed}.json")

    def pair(
        self, token: str, pin: str, cookie: DeviceCookie, address: str, former: DeviceCookie | None = None
    ) -> Device:
        """Use an invitation up: make the entry of a device.

        Args:
            cookie: New, for this device.
            former: What the browser has shown: the entry of that is taken away, because the browser forgets it.

        Raises:
            PairingError: ``pin``, and the invitation stays; ``code``.
        """
        if why := refusal(pin):
            raise PairingError("pin", Sentence("view.pair.pin", why=why))
        hashed = hash_of(token)
        with self._locked():
            found = self._invitation(hashed)
            if found is None or not self._is_good(found):
                raise no_invitation()
            own = self._own()
            text = unseal(key_of_token(own, token.encode()), _bytes(found.sealed), _about_invitation(found))
            if text is None:
                raise no_invitation()
            # gone before there is anything to show for it: whatever breaks here, it is not used twice
            _remove(self._invitations / f"{hashed}.json")
            device = self._entry(found, json.loads(text), own, pin, cookie, hashed, address)
            self._write(self._devices / f"{cookie.device}.json", device)
            if former is not None and self._opened(former) is not None:
                _remove(self._devices / f"{former.device}.json")
            return device

    def _entry(
        self,
        found: Invitation,
        passwords: dict[str, str],
        own: bytes,
        pin: str,
        cookie: DeviceCookie,
        hashed: str,
        address: str,
    ) -> Device:
        salt, secret = secrets.token_bytes(SALT), cookie.secret.encode()
        device = Device(
            cookie.device, self._next_number(), found.account, found.device_account, hashed, address, self._now(),
            _text(salt), "", "",
        )  # fmt: skip
        with_pin = key_of_pin(own, secret, cookie.device, pin, salt, self._cost)
        without = key_of_device(own, secret, cookie.device)
        return replace(
            device,
            pin_sealed=_text(
                seal(with_pin, secrets.token_bytes(NONCE), passwords["account"], _about(device, device.account))
            ),
            device_sealed=_text(
                seal(without, secrets.token_bytes(NONCE), passwords["device"], _about(device, device.device_account))
            ),
        )

    # -- devices

    def device_of(self, cookie: DeviceCookie | None) -> Device | None:
        """Return the entry that a browser's cookie opens; None when it is not paired, or not any more."""
        opened = self._opened(cookie) if cookie is not None else None
        return opened[0] if opened is not None else None

    def password_without_pin(self, cookie: DeviceCookie | None, account: str) -> str:
        """Return the password of the account for devices.

        Args:
            account: Which one the device logs in to: only its own.

        Raises:
            PairingError: ``device``.
        """
        device, password = self._opened_or_refused(cookie)
        if device.device_account != account:
            raise _not_paired()
        return password

    def password(self, cookie: DeviceCookie | None, account: str, pin: str) -> str:
        """Return the password of the person's account, and forget the wrong PINs before this one.

        A try is counted, on the disk, before it is made: neither several at once nor a new start of the console give more of them.

        Raises:
            PairingError: ``device``, ``erased``, ``wrong``.
        """
        with self._locked():
            device, _ = self._opened_or_refused(cookie)
            assert cookie is not None
            if device.account != account:
                raise _not_paired()
            if not device.has_pin:
                self._erase(device)
                raise PairingError("erased", Sentence("view.pair.erased", number=device.number), device.number)
            tried = replace(device, wrong=device.wrong + 1)
            self._write_device(tried)
            secret, salt = cookie.secret.encode(), _bytes(device.salt)
            key = key_of_pin(self._own(), secret, device.device, pin[:64], salt, self._cost)
            password = unseal(key, _bytes(device.pin_sealed), _about(device, account))
            if password is None:
                if not tried.has_pin:
                    self._erase(tried)
                raise PairingError(
                    "wrong",
                    Sentence("view.pair.wrong", number=device.number, left=tried.left),
                    device.number,
                    tried.left,
                )
            self._write_device(replace(device, wrong=0, used=self._now()))
            return password

    def _erase(self, device: Device) -> None:
        if device.pin_sealed:
            self._write_device(replace(device, pin_sealed=""))

    def is_paired(self, device: str) -> bool:
        """Return whether there still is an entry of a device."""
        try:
            (self._devices / f"{device}.json").stat()
        except FileNotFoundError:
            return False
        return True

    def devices(self, account: str = "") -> list[Device]:
        """Return the devices of an account, or of all, by their numbers; without what `unreadable` tells."""
        found = (each for each in self._all(Device) if isinstance(each, Device) and account in ("", each.account))
        return sorted(found, key=lambda each: each.number)

    def unreadable(self) -> list[str]:
        """Return in sentences which files of the folder are of another version, or of another user: nobody can use them."""
        return [
            str(each)
            for each in (*self._all(Device), *self._all(Invitation))
            if isinstance(each, ConstructionTwinError)
        ]

    def revoke(self, account: str, number: int | None = None) -> list[Device]:
        """Take devices of an account away, all or one, with all the invitations for it; return which.

        Args:
            number: None: all of them.
        """
        with self._locked():
            gone = [each for each in self.devices(account) if number in (None, each.number)]
            for each in gone:
                _remove(self._devices / f"{each.device}.json")
            for path in self._invitations.glob("*.json") if number is None else ():
                with contextlib.suppress(ConstructionTwinError):
                    found = self._read(path, Invitation)
                    if found is not None and found.account == account:
                        _remove(path)
            return gone

    # -- files

    def _opened_or_refused(self, cookie: DeviceCookie | None) -> tuple[Device, str]:
        opened = self._opened(cookie) if cookie is not None else None
        if opened is None:
            raise _not_paired()
        return opened

    def _opened(self, cookie: DeviceCookie) -> tuple[Device, str] | None:
        """Return the entry that a cookie opens, and what it may have without a PIN: who has another cookie changes nothing."""
        device = self._read(self._devices / f"{cookie.device}.json", Device)
        if device is None or device.device != cookie.device:
            return None
        key = key_of_device(self._own(), cookie.secret.encode(), cookie.device)
        password = unseal(key, _bytes(device.device_sealed), _about(device, device.device_account))
        return (device, password) if password is not None else None

    def _invitation(self, hashed: str) -> Invitation | None:
        # what a browser says becomes part of a path only where it is a hash
        if len(hashed) != 64 or set(hashed) - set("0123456789abcdef"):
            return None
        return self._read(self._invitations / f"{hashed}.json", Invitation)

    def _is_good(self, found: Invitation) -> bool:
        return found.made - _AHEAD_S <= self._now() < found.expires

    def _tidy(self, now: float) -> None:
        """Take away what is too old to be used."""
        for path in self._invitations.glob("*.json"):
            with contextlib.suppress(ConstructionTwinError):
                found = self._read(path, Invitation)
                if found is not None and now >= found.expires:
                    _remove(path)

    def _all(self, kind: type[_Kept]) -> Iterator[_Kept | ConstructionTwinError]:
        for path in sorted((self._devices if kind is Device else self._invitations).glob("*.json")):
            try:
                found = self._read(path, kind)
            except ConstructionTwinError as error:
                yield error
            else:
                if found is not None:
                    yield found

    def _own(self) -> bytes:
        """Return the console's secret."""
        return bytes.fromhex(self._secret.read_text(encoding="ascii"))

    def _next_number(self) -> int:
        path = self.folder / "numbers"
        number = int(path.read_text(encoding="ascii")) + 1 if path.exists() else 1
        _write_durable(path, str(number))
        return number

    def _write_device(self, device: Device) -> None:
        self._write(self._devices / f"{device.device}.json", device)

    def _write(self, path: Path, kept: Invitation | Device) -> None:
        _write_durable(path, json.dumps({"version": _VERSION, **asdict(kept)}))

    def _read(self, path: Path, kind: type[_Kept]) -> _Kept | None:
        """Return what stands in a file; None when there is none.

        Raises:
            ConstructionTwinError: When it is no such file.
        """
        try:
            fields: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
            if fields.pop("version") != _VERSION:
                raise ValueError("another version")
            return kind(**fields)
        except FileNotFoundError:
            return None
        except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
            raise ConstructionTwinError(Sentence("view.pair.unreadable", file=str(path), problem=str(error))) from error

    @contextlib.contextmanager
    def _locked(self) -> Iterator[None]:
        # the lock is of this open file: threads of one process wait for each other, too
        with open(os.open(self.folder / "lock", os.O_RDWR | os.O_CREAT, 0o600), "rb") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            yield


def hash_of(token: str) -> str:
    """Return the hash by which an invitation is found."""
    return hashlib.sha256(token.encode()).hexdigest()


def _not_paired() -> PairingError:
    return PairingError("device", Sentence("view.pair.device"))


def _about(device: Device, account: str) -> str:
    return f"{device.device} {account}"


def _about_invitation(invitation: Invitation) -> str:
    return f"{invitation.account} {invitation.device_account} {invitation.made!r} {invitation.expires!r}"


def _text(data: bytes) -> str:
    return base64.b64encode(data).decode()


def _bytes(text: str) -> bytes:
    return base64.b64decode(text)


def _write_durable(path: Path, content: str) -> None:
    """Write a file in one step, readable by its owner only, and have it on the disk."""
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    try:
        with open(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
            file.write(content.encode())
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
    _sync_folder(path.parent)


def _remove(path: Path) -> None:
    path.unlink(missing_ok=True)
    _sync_folder(path.parent)


def _sync_folder(folder: Path) -> None:
    number = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)
