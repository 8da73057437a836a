"""A sealed file: encrypted, authenticated, opened only with its key.

Standard library only: SHAKE-256 over key and nonce gives the key stream, HMAC-SHA256 over
everything the tag (encrypt, then authenticate). Meant against looking too early and against changes
afterwards, not against somebody who holds the key.
"""

import hashlib
import hmac
import secrets
from pathlib import Path

_MAGIC = b"blindgap1\n"
_NONCE, _TAG, KEY_BYTES = 16, 32, 32


class SealError(ValueError):
    """A sealed file that does not open: wrong key, cut off or changed."""


def _stream(key: bytes, nonce: bytes, size: int) -> bytes:
    return hashlib.shake_256(b"stream" + key + nonce).digest(size)


def _tag(key: bytes, data: bytes) -> bytes:
    return hmac.new(hashlib.sha256(b"tag" + key).digest(), data, hashlib.sha256).digest()


def make_key() -> bytes:
    """A new key."""
    return secrets.token_bytes(KEY_BYTES)


def seal(text: bytes, key: bytes, nonce: bytes | None = None) -> bytes:
    """Encrypt and authenticate.

    Raises:
        ValueError: key or nonce has the wrong length.
    """
    nonce = secrets.token_bytes(_NONCE) if nonce is None else nonce
    if len(key) != KEY_BYTES or len(nonce) != _NONCE:
        raise ValueError(f"a key has {KEY_BYTES} bytes and a nonce {_NONCE}")
    stream = _stream(key, nonce, len(text))
    body = _MAGIC + nonce + bytes(a ^ b for a, b in zip(text, stream, strict=True))
    return body + _tag(key, body)


def unseal(sealed: bytes, key: bytes) -> bytes:
    """Give the text back.

    Raises:
        SealError: the key is not the file's, or the file is not what was sealed.
    """
    head = len(_MAGIC) + _NONCE
    body, tag = sealed[:-_TAG], sealed[-_TAG:]
    if len(body) < head or not body.startswith(_MAGIC):
        raise SealError("not a sealed file, or cut off")
    if not hmac.compare_digest(tag, _tag(key, body)):
        raise SealError("wrong key, or the sealed file was changed")
    stream = _stream(key, body[len(_MAGIC) : head], len(body) - head)
    return bytes(a ^ b for a, b in zip(body[head:], stream, strict=True))


def sha256(data: bytes) -> str:
    """SHA-256 in hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def save_key(path: Path, key: bytes) -> None:
    """Write a key that only its owner can read.

    Raises:
        OSError: the file exists or cannot be written.
    """
    path.touch(mode=0o600, exist_ok=False)
    path.write_text(key.hex() + "\n")


def load_key(path: Path) -> bytes:
    """Read a key.

    Raises:
        OSError: it cannot be read.
        SealError: it is no key.
    """
    try:
        key = bytes.fromhex(path.read_text().strip())
    except ValueError as error:
        raise SealError(f"{path} is no key") from error
    if len(key) != KEY_BYTES:
        raise SealError(f"{path} is no key")
    return key
