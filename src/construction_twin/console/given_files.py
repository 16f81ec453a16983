"""The files that the console is given at its start: certificates and the list of rights. What cannot work is one sentence.

It needs no package: what starts the console asks it before.
"""

from __future__ import annotations

import json
import ssl
from pathlib import Path

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.sentences import Sentence


def own_tls(certificate: Path, key: Path) -> ssl.SSLContext:
    """Return what the console shows to browsers.

    Raises:
        ConfigurationError: When the files cannot be read, are no PEM, or do not fit each other.
    """
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    try:
        # a key with a passphrase is refused: nobody is there to type it
        context.load_cert_chain(certificate, key, password="")
    except (OSError, ssl.SSLError) as error:
        raise ConfigurationError("--certificate and --key", str(error), Sentence("expected.pem")) from error
    return context


def broker_tls(ca: Path) -> ssl.SSLContext:
    """Return what the broker's certificate is checked by.

    Raises:
        ConfigurationError: When the file cannot be read, or is no PEM.
    """
    try:
        return ssl.create_default_context(cafile=str(ca))
    except (OSError, ssl.SSLError) as error:
        raise ConfigurationError("--broker-ca", str(error), Sentence("expected.pem")) from error


def check_rights(path: Path) -> None:
    """Check that a file is a list of rights: with another one the page would draw everything, and nobody would know why.

    Raises:
        ConfigurationError: When it cannot be read, or is none.
    """
    expected = Sentence("expected.rights")
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ConfigurationError("--rights", f"{path}: {error}", expected) from error
    if not isinstance(document, dict) or not isinstance(document.get("robots"), dict):
        raise ConfigurationError("--rights", str(path), expected)
