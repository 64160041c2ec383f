"""Certificates of TLS: whether a pair of files can be used, and one that is made on the spot."""

from __future__ import annotations

import shutil
import ssl
import subprocess
from pathlib import Path

DAYS = 30
MAKE_S = 30


class CertificateError(ValueError):
    """A certificate cannot be used or made; the message says why and what to do."""


def check_pair(certificate: Path, key: Path) -> None:
    """Raise CertificateError unless both files are PEM, belong together, and the key has no password."""
    for path in (certificate, key):
        try:
            path.open("rb").close()
        except OSError as failed:
            raise CertificateError(f"{path} cannot be read: {failed.strerror}") from None
    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(certificate, key, password="")
    except (ssl.SSLError, OSError, ValueError):
        advice = "give PEM files of one pair, the key without a password"
        raise CertificateError(f"{certificate} and {key} are no certificate with its key: {advice}") from None


def self_signed(folder: Path, address: str) -> tuple[Path, Path]:
    """Make a certificate for an IP address and return the files of it and its key, PEM, in ``folder``.

    It is valid for a month and signed by itself, so browsers ask before they show the page. Raises CertificateError
    where the command ``openssl`` is missing or fails.
    """
    openssl = shutil.which("openssl")
    if openssl is None:
        raise CertificateError("the certificate is made by the command openssl, which is not installed: install it")
    certificate, key = folder / "certificate.pem", folder / "key.pem"
    command = [openssl, "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
    command += ["-days", str(DAYS), "-subj", "/CN=MFCMT demo", "-keyout", str(key), "-out", str(certificate)]
    for extension in (f"subjectAltName=IP:{address}", "extendedKeyUsage=serverAuth"):
        command += ["-addext", extension]
    done = subprocess.run(command, capture_output=True, text=True, timeout=MAKE_S, check=False)  # noqa: S603
    if done.returncode:
        last = done.stderr.strip().rpartition("\n")[2]
        raise CertificateError(f"openssl made no certificate (version 1.1.1 or newer is needed): {last}")
    return certificate, key
