# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The manifest of a bag: what its recorder wrote, with a SHA-256 of each chunk and of each file.

It is the file `manifest.json` beside `metadata.yaml`, written last. Who alters the bag can alter
the manifest too, unless it is signed: `ssh-keygen -Y sign -n vgps-bag -f KEY manifest.json` writes
`manifest.json.sig`, as git signs commits with ssh keys.
"""

import hashlib
import struct
import subprocess
from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO

from vgps_ros.bags.metadata import FILE_NAME as METADATA
from vgps_ros.core.checks import quoted, told
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.storage.files import read_json, write_json

FILE_NAME, SIGNATURE = "manifest.json", "manifest.json.sig"
_NAMESPACE = "vgps-bag"  # which keeps a signature for one purpose from serving another
_FORMAT = 1
_LARGEST = 2**26  # of a manifest that is read [bytes]
DIGEST = struct.Struct("<Q32s")  # end of a block [bytes], and its SHA-256
_TIMEOUT = 30.0  # for ssh-keygen, which may ask a key's agent [s]


@dataclass(frozen=True)
class FileDigest:
    """The content that one file of a bag must have, as digests and counts.

    Attributes:
        sha256: of the whole file.
        chunks: begin and end of each block in the file [bytes], and its SHA-256.
        messages: number of messages of each topic.
    """

    sha256: str
    chunks: list[tuple[int, int, str]]
    messages: dict[str, int]

    def __post_init__(self) -> None:
        for begin, end, _ in self.chunks:
            if not _is_count(begin) or not _is_count(end) or begin > end:
                raise ValueError(f"a chunk reaches from byte {quoted(begin)} to {quoted(end)}")
        for topic, count in self.messages.items():
            if not _is_count(count):
                raise ValueError(f"{quoted(topic)} has {quoted(count)} messages")


@dataclass(frozen=True)
class PackedDigest:
    """The digest of a file as a recorder keeps it until the bag ends.

    As a `FileDigest` it would take six times as much memory for each chunk.

    Attributes:
        sha256: of the whole file.
        begin: of the first block in the file [bytes].
        blocks: end of each block, and its SHA-256, as DIGEST packs them.
        messages: number of messages of each topic.
    """

    sha256: str
    begin: int
    blocks: bytes
    messages: dict[str, int]

    def unpacked(self) -> FileDigest:
        """Returns the digest as the manifest has it."""
        found = list(DIGEST.iter_unpack(self.blocks))
        begins = [self.begin, *(end for end, _ in found)]
        chunks = [
            (begin, end, sha256.hex()) for begin, (end, sha256) in zip(begins, found, strict=False)
        ]
        return FileDigest(self.sha256, chunks, self.messages)


@dataclass(frozen=True)
class ManifestCheck:
    """The outcome of comparing a bag with its manifest.

    Attributes:
        chunks: number of chunks that are as the recorder closed them.
        files: number of files that are.
        wrong: a sentence for each part that is not.
        lost: messages that came to the recorder and that it could not write.
        messages: number of messages of each topic that has any.
    """

    chunks: int
    files: int
    wrong: list[str]
    lost: int
    messages: dict[str, int]


def write_manifest(path: Path, files: Mapping[str, PackedDigest], lost: int) -> None:
    """Writes the manifest of a bag that is complete.

    Raises:
        OSError: it cannot be written.
    """
    metadata = hashlib.sha256((path / METADATA).read_bytes()).hexdigest()
    described = {name: asdict(file.unpacked()) for name, file in files.items()}
    content = {"format": _FORMAT, METADATA: metadata, "files": described, "lost": lost}
    write_json(path / FILE_NAME, content)


def check_manifest(path: Path) -> ManifestCheck | None:
    """Compares the files of a bag with its manifest; returns None if it has none.

    Raises:
        InvalidInputError: the manifest cannot be read.
        OSError: a file cannot be read.
    """
    if not (path / FILE_NAME).exists():
        return None
    content = _read(path / FILE_NAME)
    wrong, chunks, whole = [], 0, 0
    try:
        wanted = {str(name): FileDigest(**file) for name, file in content["files"].items()}
        metadata, lost = path / METADATA, int(content["lost"])
        if hashlib.sha256(metadata.read_bytes()).hexdigest() != content[METADATA]:
            wrong.append(f"{METADATA} is not as the recorder wrote it")
        present = {file.name for file in path.glob("*.mcap")}
        wrong += [f"{name} is not in the manifest" for name in sorted(present - set(wanted))]
        for name, file in wanted.items():
            if Path(name).name != name or not (path / name).is_file():
                wrong.append(f"{name} is missing")
                continue
            begins = [begin for begin, _, _ in file.chunks]
            ends = [end for _, end, _ in file.chunks]
            if begins[1:] != ends[:-1] or any(e <= b for b, e in zip(begins, ends, strict=True)):
                wrong.append(f"the manifest's chunks of {name} do not follow each other")
            with (path / name).open("rb") as stream:
                altered = list(_altered(stream, file.chunks))
                is_whole = _digest(stream) == file.sha256
            chunks += len(file.chunks) - len(altered)
            whole += is_whole
            wrong += [f"the chunk at byte {begin} of {name} is altered" for begin in altered]
            if not (is_whole or altered):
                wrong.append(f"{name} is altered outside its chunks")
        messages = dict(sum((Counter(file.messages) for file in wanted.values()), Counter()))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise _unreadable(path / FILE_NAME, error) from error
    return ManifestCheck(chunks, whole, wrong, lost, messages)


def sign(path: Path, key: Path) -> None:
    """Signs the manifest of a bag with an ssh key.

    Raises:
        InvalidInputError: the bag has no manifest, or ssh-keygen refuses the key.
    """
    if not (path / FILE_NAME).is_file():
        raise InvalidInputError(f"'{path}' has no {FILE_NAME} to sign: record it anew.")
    (path / SIGNATURE).unlink(missing_ok=True)
    _ssh_keygen("sign", "-f", str(key), "-n", _NAMESPACE, str(path / FILE_NAME))


def signer(path: Path, signers: Path) -> str:
    """Returns who signed the manifest of a bag.

    Args:
        path: folder of the bag.
        signers: file of the signers that are trusted, as `man ssh-keygen` describes it under
            ALLOWED SIGNERS.

    Raises:
        InvalidInputError: there is no signature, or not a good one of a trusted signer.
    """
    if not (path / SIGNATURE).is_file():
        raise InvalidInputError(f"'{path}' is not signed: it has no {SIGNATURE}.")
    name = _principal(path, signers)
    try:
        return _verified(path, signers, name)
    except InvalidInputError:
        # Of a key that stands in several lines, ssh-keygen names the first, whatever it is for.
        with TemporaryDirectory(prefix="vgps_ros_") as folder:
            one = Path(folder, "signer")
            for line in signers.read_bytes().splitlines():
                one.write_bytes(line + b"\n")
                with suppress(InvalidInputError):
                    return _verified(path, one, _principal(path, one))
        raise


def _principal(path: Path, signers: Path) -> str:
    """Returns the first name of the first signer with the signature's key."""
    of = ("-f", str(signers), "-s", str(path / SIGNATURE))
    return (_ssh_keygen("find-principals", *of).splitlines() or [""])[0]


def _verified(path: Path, signers: Path, name: str) -> str:
    """Returns the name, if the signature is good."""
    of = ("-f", str(signers), "-s", str(path / SIGNATURE))
    text = (path / FILE_NAME).read_bytes()
    _ssh_keygen("verify", "-I", name, "-n", _NAMESPACE, *of, text=text)
    return name


def _ssh_keygen(action: str, *words: str, text: bytes = b"") -> str:
    try:
        run = subprocess.run(
            ["ssh-keygen", "-Y", action, *words],
            input=text,
            capture_output=True,
            timeout=_TIMEOUT,
            check=False,
        )
    except (OSError, subprocess.SubprocessError) as error:
        raise InvalidInputError(f"ssh-keygen cannot {action}: {error}.") from error
    if run.returncode:
        said = " ".join(run.stderr.decode(errors="replace").split())
        raise InvalidInputError(f"ssh-keygen does not {action}: {said or 'it gives no reason'}.")
    return run.stdout.decode(errors="replace")


def _altered(stream: BinaryIO, chunks: Iterable[tuple[int, int, str]]) -> Iterable[int]:
    """Yields where each chunk begins that has another SHA-256."""
    for begin, end, digest in chunks:
        stream.seek(begin)
        if _digest(stream, end - begin) != digest:
            yield begin
    stream.seek(0)


def _digest(stream: BinaryIO, length: int = 2**62) -> str:
    """Returns the SHA-256 of what follows in a file, up to a length [bytes]."""
    digest = hashlib.sha256()
    while length > 0 and (data := stream.read(min(length, 2**20))):
        digest.update(data)
        length -= len(data)
    return digest.hexdigest()


def _read(path: Path) -> dict[str, Any]:
    try:
        if not path.is_file() or path.stat().st_size > _LARGEST:
            raise ValueError("it is no file, or too large")
        content: dict[str, Any] = read_json(path)
        if content["format"] != _FORMAT:
            raise ValueError(f"its format is {quoted(content['format'])}")
        if not _is_count(content["lost"]):
            raise ValueError(f"{quoted(content['lost'])} messages were lost")
    except (ValueError, KeyError, TypeError) as error:
        raise _unreadable(path, error) from error
    return content


def _is_count(value: object) -> bool:
    return type(value) is int and 0 <= value < 2**62  # no place in a file is larger


def _unreadable(path: Path, error: Exception) -> InvalidInputError:
    return InvalidInputError(f"'{path}' is not a manifest of format {_FORMAT}: {told(error)}.")
