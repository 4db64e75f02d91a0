"""Files for deployment in `server/deploy`: syntax and options, checked by the tools that are installed."""

import json
import os
import re
import shutil
import socket
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml

from http_servers import RunningServer
from present import present
from roomlight_server.base.settings import ServerSettings, load_settings
from roomlight_server.base.tls import ensure_certificate

DEPLOY = Path(__file__).parents[2] / "server" / "deploy"
TOKEN = "a-token-of-the-deployment-test"


def text(name):
    return (DEPLOY / name).read_text(encoding="utf-8")


def test_all_variables_of_the_files_are_settings():
    known = {f"ROOMLIGHT_{name.upper()}" for name in ServerSettings.model_fields} | {"ROOMLIGHT_DOMAIN"}
    for path in DEPLOY.iterdir():
        assert set(re.findall(r"\bROOMLIGHT_[A-Z_]+", path.read_text(encoding="utf-8"))) <= known, path.name


def test_the_image_listens_and_saves_without_rights(monkeypatch):
    docker = text("Dockerfile")
    variables = dict(re.findall(r"(ROOMLIGHT_\w+)=(\S+)", docker))
    monkeypatch.setenv("ROOMLIGHT_TOKENS", TOKEN)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    settings = load_settings()
    assert (settings.host, settings.state_dir) == ("0.0.0.0", Path("/var/lib/roomlight"))
    user = present(re.search(r"^USER (\d+):(\d+)$", docker, re.MULTILINE))
    assert int(user[1]) > 0
    assert docker.index("roomlight_server.precompile") < docker.index("USER ")


INSTRUCTION = re.compile("CMD|COPY|ENTRYPOINT|ENV|EXPOSE|FROM|HEALTHCHECK|RUN|STOPSIGNAL|USER|VOLUME|WORKDIR")


def instructions(name):
    """Return the instructions of a Dockerfile as (word, rest), with continued lines joined."""
    lines = [line for line in text(name).splitlines() if not line.startswith("#")]
    joined = "\n".join(lines).replace("\\\n", " ")
    return [(line.split()[0], line.split(maxsplit=1)[1]) for line in joined.splitlines() if line.strip()]


def test_the_dockerfile_parses_and_finds_its_files():
    found = instructions("Dockerfile")
    assert all(INSTRUCTION.fullmatch(word) for word, _ in found)
    stages = [rest.split(" AS ")[-1] for word, rest in found if word == "FROM"]
    copied = {}
    for word, rest in found:
        parts = rest.split()
        if word == "COPY":
            flags = [part for part in parts if part.startswith("--")]
            sources, target = [part for part in parts if part not in flags][:-1], parts[-1]
            stage = [flag.removeprefix("--from=") for flag in flags if flag.startswith("--from=")]
            assert set(stage) <= set(stages)
            if not stage:
                assert all((DEPLOY.parents[1] / source).exists() for source in sources)
            copied[Path(target).name] = flags
        if word == "RUN":
            subprocess.run(["sh", "-n", "-c", rest], check=True)
    (entry,) = [json.loads(rest) for word, rest in found if word == "ENTRYPOINT"]
    assert copied[entry[0]] == ["--chmod=755"]
    health = next(rest for word, rest in found if word == "HEALTHCHECK")
    assert json.loads(health[health.index("[") :])[:2] == ["python", "-c"]


@pytest.mark.parametrize("secure", [False, True], ids=["http", "https"])
def test_the_health_check_asks_the_server_and_no_proxy(secure, tmp_path):
    """With `HTTP_PROXY` set, as for downloads, with a port or a certificate, each container was unhealthy."""
    files = dict(zip(("tls_cert", "tls_key"), ensure_certificate(tmp_path, ["localhost"]), strict=True))
    settings = files if secure else {}
    health = next(rest for word, rest in instructions("Dockerfile") if word == "HEALTHCHECK")
    code = json.loads(health[health.index("[") :])[2]
    with RunningServer(**settings) as server, socket.create_server(("127.0.0.1", 0)) as closed:
        proxy = f"http://127.0.0.1:{closed.getsockname()[1]}"
        command = [sys.executable, "-c", code.replace("timeout=2", "timeout=600")]
        environment = {key: value for key, value in os.environ.items() if key.lower() != "no_proxy"}
        environment |= {"http_proxy": proxy, "HTTP_PROXY": proxy, "ROOMLIGHT_PORT": str(server.port)}
        environment |= {f"ROOMLIGHT_{name.upper()}": str(path) for name, path in settings.items()}
        closed.close()  # nobody listens there
        subprocess.run(command, env=environment, check=True)


def test_the_image_gets_every_package():
    """Only what `.dockerignore` names is copied into the build."""
    named = {line.removeprefix("!") for line in text("Dockerfile.dockerignore").splitlines() if line.startswith("!")}
    root = DEPLOY.parents[1]
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))
    packages = {Path(each).parts[0] for each in project["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]}
    assert packages | {"pyproject.toml", "README.md"} <= named
    assert all((root / name).exists() for name in named)


def test_compose_names_only_what_it_declares():
    compose = yaml.safe_load(text("compose.yaml"))
    assert set(compose) == {"services", "networks", "volumes", "secrets"}
    for service in compose["services"].values():
        volumes = {volume.split(":")[0] for volume in service["volumes"]}
        assert all(name in compose["volumes"] or (DEPLOY / name).is_file() for name in volumes)
        assert set(service["networks"]) <= set(compose["networks"])
        assert set(service.get("secrets", [])) <= set(compose["secrets"])
        assert set(service.get("depends_on", {})) <= set(compose["services"])
    build = compose["services"]["roomlight"]["build"]
    context = (DEPLOY / build["context"]).resolve()
    assert (context / build["dockerfile"]).is_file()
    assert compose["networks"]["inside"] == {"internal": True}
    assert compose["services"]["roomlight"]["networks"] == ["inside"]


def manager_of_envoy():
    listener = yaml.safe_load(text("envoy.yaml"))["static_resources"]["listeners"][0]
    return listener["filter_chains"][0]["filters"][0]["typed_config"]


def test_proxies_choose_the_server_by_session():
    nginx = text("nginx.conf")
    assert "hash $session consistent;" in nginx
    assert "$http_x_session_id" in nginx
    assert '"" none;' in nginx  # without a session: one server
    routes = manager_of_envoy()["route_config"]["virtual_hosts"][0]["routes"]
    policies = [route["route"]["hash_policy"] for route in routes if "route" in route]
    names = [[entry["header"]["header_name"] for entry in policy] for policy in policies]
    assert names == [[":path"], [":path"], ["x-session-id", ":path"], ["x-session-id", ":path"]]
    assert policies[2][0]["terminal"]
    constant = policies[2][1]["header"]["regex_rewrite"]
    assert re.sub(constant["pattern"]["regex"], constant["substitution"], "/v1/pairing") == "none"
    rewrite = policies[0][0]["header"]["regex_rewrite"]
    pattern, substitution = rewrite["pattern"]["regex"], rewrite["substitution"]
    paths = ("/v1/sessions/room-1", "/v1/sessions/room-1/frames/7", "/v1/sessions/room-1/probe?x=1&y=/v1/sessions/z")
    assert {re.sub(pattern, substitution, path) for path in paths} == {"room-1"}


def test_the_address_of_a_client_is_not_what_it_writes():
    """The log has the address of a wrong token, and named the one that the client wrote."""
    assert "proxy_set_header X-Forwarded-For $remote_addr;" in text("nginx.conf")
    assert manager_of_envoy()["use_remote_address"] is True


def test_a_composite_has_more_than_its_time_limit():
    """A proxy gave up after 75 s, and asked another server, which took over the session."""
    limit_s = ServerSettings().composite_timeout_s
    (composite,) = re.findall(r"location ~ (\S+) \{[^}]*proxy_read_timeout (\d+)s", text("nginx.conf"))
    assert re.search(composite[0], "/v1/sessions/room/composite")
    assert int(composite[1]) > limit_s
    assert "non_idempotent;" not in text("nginx.conf")
    route = manager_of_envoy()["route_config"]["virtual_hosts"][0]["routes"][1]
    assert re.fullmatch(route["match"]["safe_regex"]["regex"], "/v1/sessions/room/composite")
    assert min(float(route["route"][name].rstrip("s")) for name in ("timeout", "idle_timeout")) > limit_s


def test_a_film_has_time_to_be_sent():
    """Envoy's time limit is that of the whole answer."""
    *_, film, others = manager_of_envoy()["route_config"]["virtual_hosts"][0]["routes"]
    assert re.fullmatch(film["match"]["safe_regex"]["regex"], "/v1/recordings/r-0123456789abcdef/film")
    assert float(film["route"]["timeout"].rstrip("s")) > float(others["route"]["timeout"].rstrip("s"))


def test_paths_are_compared_as_the_server_reads_them():
    assert manager_of_envoy()["normalize_path"] is True  # `/v1/../metrics` was no `/metrics`; nginx does it by itself


def test_the_entry_point_starts_with_a_writable_cache(tmp_path):
    """numba uses no cache in a folder that it cannot write to, and the root of the container is read-only."""
    kernels, tools = tmp_path / "kernels", tmp_path / "bin"
    for folder in (kernels, tools, tmp_path / "tmp"):
        folder.mkdir()
    (kernels / "blend.nbi").write_text("compiled")
    (tools / "roomlight").write_text('#!/bin/sh\necho "$NUMBA_CACHE_DIR $*"\n')
    (tools / "roomlight").chmod(0o755)
    script = tmp_path / "entrypoint.sh"
    script.write_text(text("entrypoint.sh").replace("/opt/roomlight/kernels", str(kernels)))
    environment = {"PATH": f"{tools}:{os.environ['PATH']}", "TMPDIR": str(tmp_path / "tmp")}
    for _ in range(2):  # also when the container is started again
        ran = subprocess.run(["sh", script, "serve"], env=environment, capture_output=True, text=True, check=True)
        cache, *arguments = ran.stdout.split()
        assert arguments == ["serve"]
        assert [path.name for path in Path(cache).iterdir()] == ["blend.nbi"]


def compiled_by(script, before, cache):
    """What lines of Python compile, by lines on the output, after others have run."""
    code = f"""
from numba.core.event import install_recorder
{before}
with install_recorder("numba:compile") as recorder:
    {script}
for _, event in recorder.buffer:
    print(event.data["dispatcher"], event.data["args"])
"""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(cache)}
    return subprocess.run([sys.executable, "-c", code], env=environment, check=True, capture_output=True, text=True)


@pytest.mark.slow
def test_a_server_needs_no_compiler_after_precompiling(tmp_path):
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-m", "roomlight_server.precompile"]
    subprocess.run(command, env=environment, check=True, capture_output=True)
    compiled = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.nbc")}
    kernels = {path.name.split(".")[0] for path in compiled}
    assert {"blend", "march", "paths", "preview", "shadow_rays", "encode"} <= kernels  # of light and of composites
    ran = compiled_by("precompile.main()", "from roomlight_server import precompile", tmp_path)
    assert ran.stdout.splitlines()[1:] == []  # nor kernels without a cache, which leave no file
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.nbc")} == compiled


BESIDE = """
from roomlight.engine.kernels import blend, rasterise
from roomlight.engine.session import warm_up
from roomlight_server.answers import composites
from roomlight_server.work.compiling import compile_beside

assert compile_beside("preview", "good").wait() == 0
assert compile_beside.__wrapped__("preview", "good") is None
"""


@pytest.mark.slow
def test_composites_and_meshes_need_no_compiler_after_it_ran_beside(tmp_path):
    frames = "kernels = {str(function) for part in (blend, rasterise) for function in vars(part).values()}"
    others = "recorder.buffer[:] = [event for event in recorder.buffer if str(event[1].data['dispatcher']) in kernels]"
    script = f"composites.warm_up(); assert not recorder.buffer; warm_up(); {frames}; {others}"
    assert compiled_by(script, BESIDE, tmp_path).stdout == ""


def run_tool(*command, **more):
    ran = subprocess.run(command, capture_output=True, text=True, check=False, **more)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    return ran.stdout + ran.stderr


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")
def test_the_unit_is_valid_and_hardened(tmp_path):
    unit = tmp_path / "roomlight.service"
    unit.write_text(text("roomlight.service").replace("/opt/roomlight/bin/roomlight", sys.executable))
    assert run_tool("systemd-analyze", "verify", str(unit)) == ""
    output = run_tool("systemd-analyze", "security", "--offline=yes", "--threshold=20", str(unit))
    assert "Overall exposure level" in output


@pytest.mark.parametrize(
    "command",
    [
        ("shellcheck", str(DEPLOY / "entrypoint.sh")),
        ("hadolint", str(DEPLOY / "Dockerfile")),
        ("caddy", "validate", "--adapter", "caddyfile", "--config", str(DEPLOY / "Caddyfile")),
    ],
    ids=lambda command: command[0],
)
def test_a_file_is_valid_by_its_own_tool(command):
    if shutil.which(command[0]) is None:
        pytest.skip(f"{command[0]} is not installed")
    output = run_tool(*command, env=os.environ | {"ROOMLIGHT_DOMAIN": "localhost"})
    assert output == "" or command[0] == "caddy"


@pytest.mark.skipif(
    shutil.which("nginx") is None or shutil.which("openssl") is None, reason="nginx or openssl is not installed"
)
def test_the_nginx_configuration_is_valid(tmp_path):
    certificate, key, pid = tmp_path / "certificate.pem", tmp_path / "key.pem", tmp_path / "pid"
    run_tool(
        *("openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=localhost"),
        *("-keyout", str(key), "-out", str(certificate)),
    )
    config = text("nginx.conf").replace("/etc/ssl/light.example.org.pem", str(certificate))
    config = config.replace("/etc/ssl/light.example.org.key", str(key)).replace("/run/nginx.pid", str(pid))
    folders = "".join(
        f"    {name}_temp_path {tmp_path / name};\n" for name in ("client_body", "proxy", "fastcgi", "uwsgi", "scgi")
    )
    path = tmp_path / "nginx.conf"
    path.write_text(config.replace("http {\n", f"http {{\n{folders}", 1))
    run_tool("nginx", "-t", "-p", str(tmp_path), "-c", str(path))
