"""A server on the local network: real TLS over real sockets, certificate, token, pairing and QR codes."""

import datetime
import http.client
import json
import re
import socket
import ssl
import xml.etree.ElementTree as ElementTree

import cv2
import numpy as np
import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.x509.oid import NameOID
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from http_servers import LONG_S, TOKEN, RunningServer
from roomlight.errors import ServerError
from roomlight_client import Client, Retry, UnreachableError
from roomlight_server import serving
from roomlight_server.base import tls
from roomlight_server.base.settings import ServerSettings, load_settings
from roomlight_server.transport import lan, tls_listener

NAMES = ("127.0.0.1", "room.local", "::1")
NOW = datetime.datetime(2026, 5, 1, tzinfo=datetime.UTC)
URL = "https://192.168.1.7:8090/phone#pair=a-code-that-pairs-one-phone"


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A certificate and its key."""
    return tls.ensure_certificate(tmp_path_factory.mktemp("state"), NAMES)


@pytest.fixture(scope="module")
def server(files):
    certificate, key = files
    names = {"allow_hosts": NAMES, "public_url": "https://192.168.1.7:8090"}
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(tls_listener, "HANDSHAKE_S", LONG_S)
        with RunningServer(tokens=(TOKEN,), tls_cert=certificate, tls_key=key, **names) as running:
            yield running


def trusting(certificate):
    return ssl.create_default_context(cafile=certificate)


def call(server, path, *, host="127.0.0.1", token=TOKEN, method="GET", **headers):
    connection = http.client.HTTPSConnection("127.0.0.1", server.port, context=trusting(server.settings.tls_cert))
    try:
        given = {"Host": f"{host}:{server.port}", "Authorization": f"Bearer {token}", **headers}
        connection.request(method, path, headers=given)
        response = connection.getresponse()
        return response.status, json.loads(response.read() or b"null")
    finally:
        connection.close()


def certificate_of(files):
    return x509.load_pem_x509_certificate(files[0].read_bytes())


def test_answers_come_over_verified_tls(server):
    assert call(server, "/v1/sessions") == (200, {"sessions": [], "max_sessions": 8, "idle_expiry_s": 600.0})
    assert call(server, "/v1/sessions", token="another-token-here")[0] == 401


def test_the_client_trusts_the_certificate_it_is_given(server, monkeypatch):
    """`SSL_CERT_FILE` had no effect on this machine."""
    monkeypatch.setenv("HTTPS_PROXY", "http://127.0.0.1:1")

    def ask():
        with Client(f"https://127.0.0.1:{server.port}", retry=Retry(attempts=1)) as client:
            client.ready()

    with pytest.raises(UnreachableError, match="set SSL_CERT_FILE"):
        ask()
    monkeypatch.setenv("SSL_CERT_FILE", str(server.settings.tls_cert))
    ask()


def test_the_fingerprint_is_that_of_the_connection(server):
    with (
        server.dial() as plain,
        trusting(server.settings.tls_cert).wrap_socket(plain, server_hostname="room.local") as secure,
    ):
        assert secure.version() == "TLSv1.3"
        sent = secure.getpeercert(binary_form=True)
    assert sent is not None
    digest = tls.fingerprint(server.settings.tls_cert)
    assert re.fullmatch(r"([0-9A-F]{2}:){31}[0-9A-F]{2}", digest)
    assert x509.load_der_x509_certificate(sent) == certificate_of((server.settings.tls_cert,))


def test_websockets_over_tls_check_origin_and_token(server):
    call(server, "/v1/sessions/room", method="PUT", Origin=f"https://127.0.0.1:{server.port}")

    def dial(origin, token):
        return connect(
            f"wss://127.0.0.1:{server.port}/v1/sessions/room/stream",
            ssl=trusting(server.settings.tls_cert),
            origin=origin,
            subprotocols=[Subprotocol("roomlight.v1"), Subprotocol(f"bearer.{token}")],
            compression=None,
        )

    own = f"https://127.0.0.1:{server.port}"
    with dial(own, TOKEN) as stream:
        stream.send(json.dumps({"type": "track", "name": "table", "position": [0, 1, 0]}))
        assert json.loads(stream.recv()) == {"type": "probes", "probes": {"table": [0.0, 1.0, 0.0]}}
    for origin, token, status in (("https://evil.example", TOKEN, 403), (own, "another-token-here", 401)):
        with pytest.raises(InvalidStatus) as refused:
            dial(origin, token)
        assert refused.value.response.status_code == status


def test_pairing_names_address_code_and_fingerprint(server):
    status, pairing = call(server, "/v1/pairing", method="POST")
    assert (status, pairing["expires_in_s"], pairing["advice"]) == (200, 600.0, None)
    assert re.fullmatch(r"https://192\.168\.1\.7:8090/phone#pair=[\w-]{22}", pairing["url"])
    assert pairing["fingerprint"] == tls.fingerprint(server.settings.tls_cert)
    assert read_svg(pairing["qr_svg"]) == pairing["url"]
    assert call(server, "/v1/pairing", method="POST", token="another-token-here")[0] == 401


@pytest.mark.parametrize(
    ("settings", "advice"),
    [
        ({}, "this machine only.*roomlight serve --lan.*ROOMLIGHT_PUBLIC_URL"),
        ({"host": "0.0.0.0", "tokens": (TOKEN,)}, "set ROOMLIGHT_PUBLIC_URL.*HTTPS"),
    ],
)
def test_a_server_without_a_known_address_says_how_a_phone_reaches_it(settings, advice):
    with RunningServer(**settings) as local:
        pairing = local.call("POST", "/v1/pairing", token=TOKEN).json
    assert (pairing["url"], pairing["qr_svg"], pairing["fingerprint"]) == (None, None, None)
    assert re.search(advice, pairing["advice"])


def test_a_server_without_tokens_gives_an_address_without_a_code_that_expires():
    with RunningServer(public_url="https://room.local") as local:
        pairing = local.call("POST", "/v1/pairing").json
    assert (pairing["url"], pairing["expires_in_s"]) == ("https://room.local/phone", None)


def read_svg(svg):
    """Draw the modules of a QR code and read them."""
    root = ElementTree.fromstring(svg)
    size = int(root.get("viewBox", "").split()[2])
    modules = np.full((size, size), 255, np.uint8)
    path = root.findall("{http://www.w3.org/2000/svg}path")[-1].get("d", "")
    x = y = 0.0
    for command, first, second in re.findall(r"([Mmh])(-?[\d.]+)(?:[ ,]?(-?[\d.]+))?", path):
        if command == "h":
            modules[int(y), int(x) : int(x) + int(first)] = 0
            x += int(first)
        else:
            x, y = (x if command == "m" else 0) + float(first), (y if command == "m" else 0) + float(second)
    return read_modules(modules)


def read_modules(modules):
    """Decode a QR code; OpenCV finds no code in one of 40 pictures of a code, at any single size."""
    pictures = [np.kron(modules, np.ones((side, side), np.uint8)) for side in (6, 4, 8, 11)]
    detectors = (cv2.QRCodeDetector(), cv2.QRCodeDetectorAruco())
    texts = (detector.detectAndDecode(picture)[0] for picture in pictures for detector in detectors)
    return next((text for text in texts if text), "")


def test_the_qr_code_of_the_terminal_is_readable():
    lines = re.sub(r"\x1b\[[\d;]*m", "", lan.qr_text(URL)).splitlines()
    light = {"█": (255, 255), "▀": (255, 0), "▄": (0, 255), " ": (0, 0)}
    rows = [[light[letter][half] for letter in line] for line in lines for half in (0, 1)]
    assert read_modules(np.array(rows, np.uint8)) == URL
    assert all(line.startswith("\x1b[97;40m") for line in lan.qr_text(URL).splitlines())  # white on black everywhere


def test_certificate_and_key_are_kept(tmp_path):
    first = tls.ensure_certificate(tmp_path / "state", NAMES, now=NOW)
    before = [file.read_bytes() for file in first]
    assert tls.ensure_certificate(tmp_path / "state", NAMES[:1], now=NOW + datetime.timedelta(days=300)) == first
    assert [file.read_bytes() for file in first] == before
    key = first[1]
    assert key.stat().st_mode & 0o777 == 0o600
    assert key.parent.stat().st_mode & 0o777 == 0o700
    assert certificate_of(first).not_valid_after_utc - NOW == datetime.timedelta(days=396)


@pytest.mark.parametrize(
    ("names", "days"), [((*NAMES, "192.168.1.9"), 0), (NAMES, 367), (NAMES, -10)], ids=["new name", "old", "clock"]
)
def test_a_certificate_that_does_not_fit_is_renewed(tmp_path, names, days):
    first = tls.ensure_certificate(tmp_path, NAMES, now=NOW)
    old = certificate_of(first)
    later = NOW + datetime.timedelta(days=days)
    new = certificate_of(tls.ensure_certificate(tmp_path, names, now=later))
    assert new.serial_number != old.serial_number
    assert new.public_key() == old.public_key()  # the key stays
    assert new.not_valid_before_utc <= later < new.not_valid_after_utc
    stated = new.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert len(stated) == len(names)


def test_a_readable_key_is_made_private(tmp_path):
    _, key = tls.ensure_certificate(tmp_path, NAMES)
    key.chmod(0o644)
    tls.ensure_certificate(tmp_path, NAMES)
    assert key.stat().st_mode & 0o777 == 0o600


def test_a_damaged_key_is_not_replaced_silently(tmp_path):
    _, key = tls.ensure_certificate(tmp_path, NAMES)
    key.write_text("damaged")
    with pytest.raises(ServerError, match="delete it to make a new one"):
        tls.ensure_certificate(tmp_path, NAMES)
    assert key.read_text() == "damaged"


def test_a_folder_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ServerError, match="choose another folder"):
        tls.ensure_certificate(tmp_path / "file", NAMES)
    (tmp_path / tls.CERTIFICATE).mkdir()
    with pytest.raises(ServerError, match="choose another folder"):
        tls.ensure_certificate(tmp_path, NAMES)
    assert not [*tmp_path.glob(".*")]


def test_the_token_is_kept_and_private(tmp_path):
    token = lan.ensure_token(tmp_path / "state")
    assert len(token) >= 32
    assert lan.ensure_token(tmp_path / "state") == token
    file = tmp_path / "state" / lan.TOKEN
    assert file.stat().st_mode & 0o777 == 0o600
    file.write_text("short\n")
    with pytest.raises(ServerError, match="delete it to make a new one"):
        lan.ensure_token(tmp_path / "state")


def test_lan_options_make_what_is_missing(tmp_path, files):
    made = lan.lan_options(host="127.0.0.1", tokens=(), folder=tmp_path)
    settings = load_settings(**made, port=0)
    assert settings.host == "127.0.0.1"
    assert settings.tokens == (lan.ensure_token(tmp_path),)
    assert settings.tls_cert == tmp_path / tls.CERTIFICATE
    assert {"127.0.0.1", "localhost"} <= set(settings.allow_hosts)
    given = lan.lan_options(host="127.0.0.1", tokens=(TOKEN,), tls=files, folder=tmp_path, allow_hosts=("a.example",))
    assert given["tokens"] == (TOKEN,)
    assert (given["tls_cert"], given["tls_key"]) == files
    assert "a.example" in given["allow_hosts"]


@pytest.mark.parametrize(("host", "reason"), [("0.0.0.0", "every address"), ("room.local", "must be an address")])
def test_the_address_of_the_network_must_be_one(host, reason):
    with pytest.raises(ServerError, match=reason):
        lan.names_on_lan(host)


def test_the_names_of_the_machine_are_hosts(monkeypatch):
    monkeypatch.setattr(lan.socket, "gethostname", lambda: "Desk.example")
    found = lan.names_on_lan("192.168.1.7")
    assert found == ("192.168.1.7", "desk.example", "desk.local", "localhost", "127.0.0.1", "::1")


def test_a_machine_without_a_network_is_told(monkeypatch):
    class Unreachable(socket.socket):
        def connect(self, _):
            raise OSError(101, "Network is unreachable")

    monkeypatch.setattr(lan.socket, "socket", Unreachable)
    with pytest.raises(ServerError, match="--host"):
        lan.local_address()


def test_the_state_folder_follows_the_xdg_variable(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert lan.state_folder() == tmp_path / "roomlight"
    monkeypatch.delenv("XDG_STATE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert lan.state_folder() == tmp_path / ".local" / "state" / "roomlight"


@pytest.mark.parametrize(("days", "warnings"), [(-500, 1), (-30, 0), (30, 1)])
def test_a_certificate_that_is_not_valid_now_is_named_at_the_start(tmp_path, capfd, days, warnings):
    """Clients refused it, and the server said nothing."""
    made = datetime.datetime.now(datetime.UTC) + datetime.timedelta(days=days)
    certificate, key = tls.ensure_certificate(tmp_path, NAMES, now=made)
    settings = load_settings(tls_cert=certificate, tls_key=key, recordings_folder=certificate)
    with pytest.raises(ServerError, match="recordings_folder"):  # it does not start
        serving.serve(settings, listening=print)
    assert capfd.readouterr().err.count("the certificate is not valid now") == warnings


def short_certificate():
    """Return a certificate of a key of 1,024 bits, and its key."""
    key, today = rsa.generate_private_key(65_537, 1024), datetime.datetime.now(datetime.UTC)
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "short")])
    made = x509.CertificateBuilder(name, name, key.public_key(), 1, today, today + datetime.timedelta(days=1))
    pem, form = serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8
    return made.sign(key, hashes.SHA256()).public_bytes(pem) + key.private_bytes(
        pem, form, serialization.NoEncryption()
    )


def test_certificates_are_checked_at_the_start(files, tmp_path):
    other, _ = tls.ensure_certificate(tmp_path, NAMES)
    with pytest.raises(ServerError, match="does not belong to the file's first certificate; the server's own must"):
        load_settings(tls_cert=other, tls_key=files[1])
    with pytest.raises(ServerError, match=r"without a tls_key: cannot be used .* give the key with --tls-key"):
        load_settings(tls_cert=other)
    (tmp_path / "short.pem").write_bytes(short_certificate())
    with pytest.raises(ServerError, match=r"too short; RSA needs 2,048 bits"):
        load_settings(tls_cert=tmp_path / "short.pem")
    with pytest.raises(ServerError, match="cannot be used"):
        load_settings(tls_cert=tmp_path / "none.pem")
    with pytest.raises(ServerError, match="needs a certificate"):
        load_settings(tls_key=files[1])
    with pytest.raises(ServerError, match="not a readable certificate"):
        tls.fingerprint(files[1])


def test_a_server_on_the_network_listens_on_loopback_too(monkeypatch, files):
    """The desktop's browser opens https://localhost:PORT, a phone the address of the network."""
    bound, addresses = [], []

    class Stopped(serving.GracefulServer):
        def run(self, sockets=None):
            bound.extend(each.getsockname() for each in sockets or ())

    monkeypatch.setattr(serving, "GracefulServer", Stopped)
    monkeypatch.setattr(ServerSettings, "is_loopback", False)
    settings = ServerSettings(
        host="127.0.0.2", port=0, tokens=(TOKEN,), tls_cert=files[0], tls_key=files[1], on_lan=True
    )
    serving.serve(settings, listening=lambda *found: addresses.append(found))
    (first, port), second = bound
    assert (first, second) == ("127.0.0.2", ("127.0.0.1", port))
    [(address, phone)] = addresses
    assert address == f"https://127.0.0.2:{port}"
    assert phone.startswith(f"{address}/phone#pair=")
