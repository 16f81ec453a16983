"""make_site: what one run makes, and that the next one keeps every secret."""

from __future__ import annotations

import json
import re
import shutil
import ssl
import stat
import subprocess
from pathlib import Path

import pytest

from construction_twin.broker import make_site
from construction_twin.broker.make_site import main
from construction_twin.broker.start import check
from construction_twin.core.errors import ConfigurationError
from construction_twin.mqtt.client import load_account

ROBOT = ["--robot", "kr120"]
HOST = ["--host", "broker.example"]
PERSONS = ["--person", "ada:operate,approve", "--person", "vic:look"]


def make(folder: Path, *arguments: str) -> None:
    assert main([str(folder), *arguments]) == 0


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """A site as its first run leaves it."""
    folder = tmp_path_factory.mktemp("made") / "site"
    make(folder, *HOST, "--host", "192.168.7.10", *ROBOT, *PERSONS)
    return folder


@pytest.fixture
def folder(made, tmp_path) -> Path:
    """A copy of that site, with the modes of its files."""
    return shutil.copytree(made, tmp_path / "site")


def contents(folder: Path) -> dict[str, bytes]:
    """Return what stays from run to run: all but the servers' certificates."""
    files = [path for path in folder.rglob("*") if path.is_file() and path.name not in ("server.crt", "console.crt")]
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def names_of(folder: Path) -> set[str]:
    return {path.name for path in (folder / "accounts").iterdir()}


def test_makes_everything_a_site_needs(folder):
    broker = {path.name for path in (folder / "broker").iterdir()}
    assert broker == {"mosquitto.conf", "access.acl", "passwords", "ca.crt", "server.crt", "server.key"}
    assert names_of(folder) == {"kr120-bridge", "kr120-gateway", "ada", "vic"}
    assert {path.name for path in (folder / "accounts/kr120-bridge").iterdir()} == {
        "account.json", "ca.crt", "password"
    }  # fmt: skip


def test_nobody_but_the_owner_may_look(folder):
    for path in (folder, *folder.rglob("*")):
        assert stat.S_IMODE(path.stat().st_mode) == (0o700 if path.is_dir() else 0o600), path


def test_every_account_can_be_used_at_once(folder):
    for path in (folder / "accounts").glob("*/*.json"):
        account = load_account(path)
        assert account.context().check_hostname
        assert (account.user, len(account.password()) >= 32) == (path.parent.name, True)


def test_no_two_passwords_are_the_same_and_the_broker_gets_none(folder):
    passwords = [path.read_text().strip() for path in (folder / "accounts").glob("*/password")]
    assert len(set(passwords)) == len(passwords) == 4
    kept = "".join(path.read_text() for path in (folder / "broker").iterdir())
    assert not any(password in kept for password in passwords)


def test_no_secret_is_on_a_command_line_or_printed(tmp_path, monkeypatch, capsys):
    lines = []
    run = subprocess.run
    monkeypatch.setattr(make_site.subprocess, "run", lambda command, **o: (lines.append(command), run(command, **o))[1])
    make(tmp_path / "site", *HOST, *ROBOT, *PERSONS)
    shown = capsys.readouterr().out + str(lines)
    passwords = [path.read_text().strip() for path in (tmp_path / "site/accounts").glob("*/password")]
    assert lines and len(passwords) == 4 and not any(password in shown for password in passwords)


def test_a_second_run_changes_no_secret_and_signs_the_servers_certificates_anew(folder):
    (folder / "accounts/ada.zip").touch()
    before, signed = contents(folder), (folder / "broker/server.crt").read_bytes()
    make(folder)
    assert contents(folder) == before and (folder / "broker/server.crt").read_bytes() != signed


def test_a_robot_is_added_and_the_others_keep_what_they_have(folder):
    before = contents(folder)
    make(folder, "--robot", "kr121", "--plc")
    after = contents(folder)
    changed = {name for name in before if after[name] != before[name]}
    assert changed == {"broker/access.acl", "broker/passwords", "site.json"}
    programs = {f"{robot}-{program}" for robot in ("kr120", "kr121") for program in ("bridge", "gateway", "plc")}
    assert names_of(folder) == programs | {"ada", "vic"}
    assert set(before["broker/passwords"].splitlines()) < set(after["broker/passwords"].splitlines())


def test_a_new_name_signs_the_ca_anew_for_the_same_key_and_brings_it_to_every_account(folder, capsys):
    before = contents(folder)
    capsys.readouterr()
    make(folder, "--host", "broker-2.example")
    after = contents(folder)
    changed = {name for name in before if after[name] != before[name]}
    assert {name for name in changed if not name.endswith("ca.crt")} == {"site.json"}
    assert len({after[name] for name in after if name.endswith("ca.crt")}) == 1
    assert "broker-2.example only: every tablet and every client needs it" in capsys.readouterr().out
    assert "DNS:broker.example, IP Address:192.168.7.10, DNS:broker-2.example" in alternative_names(
        folder / "broker/server.crt"
    )
    assert verdict(folder, "broker-2.example", "broker.example") == ("", "")


def test_a_password_that_is_taken_out_of_the_broker_s_file_is_made_anew_alone(folder):
    before, passwords = contents(folder), folder / "broker/passwords"
    kept = [line for line in passwords.read_text().splitlines(keepends=True) if not line.startswith("ada:")]
    passwords.write_text("".join(kept))
    make(folder)
    after = contents(folder)
    changed = {name for name in before if after[name] != before[name]}
    assert changed == {"broker/passwords", "accounts/ada/password"}


def test_an_account_handed_out_and_deleted_here_keeps_its_password(folder):
    hashed = (folder / "broker/passwords").read_text()
    shutil.rmtree(folder / "accounts/vic")
    make(folder)
    assert (folder / "broker/passwords").read_text() == hashed and "vic" not in names_of(folder)


def rules_of(folder: Path, name: str) -> str:
    return (folder / "broker/access.acl").read_text().split(f"user {name}\n")[1].split("user ")[0]


def test_a_person_has_one_account_with_rights_of_its_own_at_each_robot(folder):
    make(
        folder,
        "--robot",
        "kr121",
        "--person",
        "bob:operate@kr120",
        "--person",
        "bob:look@kr121",
        "--person",
        "cy:approve",
    )
    assert load_account(folder / "accounts/bob/account.json").user == "bob"
    of_bob = rules_of(folder, "bob")
    assert "write twin/kr120/stop/bob" in of_bob and "write twin/kr120/plan_request/bob" in of_bob
    assert "read twin/kr121/#" in of_bob and "topic write twin/kr121" not in of_bob
    assert all(
        f"topic write twin/{robot}/{act}/cy" in rules_of(folder, "cy")
        for robot in ("kr120", "kr121")
        for act in ("review", "stop")
    )
    before = contents(folder)
    make(folder)
    assert contents(folder) == before
    # rights that are given anew are those alone; the password stays, and so do all others
    make(folder, "--person", "bob:reset@kr121")
    of_bob = rules_of(folder, "bob")
    assert "kr120" not in of_bob and "write twin/kr121/reset/bob" in of_bob and "plan_request" not in of_bob
    changed = {name for name, content in contents(folder).items() if content != before[name]}
    assert changed == {"broker/access.acl", "broker/passwords", "site.json"}
    # in another order
    hashed = (folder / "broker/passwords").read_bytes()
    assert sorted(hashed.splitlines()) == sorted(before["broker/passwords"].splitlines())


def test_the_page_gets_who_has_which_right_and_no_program(tmp_path):
    folder = tmp_path / "site"
    make(
        folder,
        *HOST,
        *ROBOT,
        "--robot",
        "kr121",
        *PERSONS,
        "--console",
        "site.local",
        "--person",
        "cy:reset@kr121",
        "--plc",
    )
    robots = json.loads((folder / "console/rights.json").read_text())["robots"]
    everywhere = {"ada": ["look", "operate", "approve"], "vic": ["look"]}
    assert robots == {"kr120": everywhere, "kr121": everywhere | {"cy": ["look", "reset"]}}


def test_what_is_taken_out_of_the_settings_is_taken_away_and_named(folder, capsys):
    settings = json.loads((folder / "site.json").read_text())
    (folder / "site.json").write_text(json.dumps(settings | {"persons": ["ada:operate"]}))
    capsys.readouterr()
    make(folder)
    assert "took the password of vic away: it is not in site.json" in capsys.readouterr().out
    for file in ("passwords", "access.acl"):
        text = (folder / "broker" / file).read_text()
        assert re.search(r"\bada\b", text) and not re.search(r"\bvic\b", text)


# -- the console


def alternative_names(certificate: Path) -> str:
    command = ["openssl", "x509", "-in", certificate, "-noout", "-ext", "subjectAltName"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def test_the_console_gets_a_certificate_for_its_own_names(folder):
    before = contents(folder)
    make(folder, "--console", "twin.example", "--console", "192.168.7.20", "--console", "fd00::7")
    changed = {name for name in before if contents(folder)[name] != before[name]}
    assert {name for name in changed if not name.endswith("ca.crt")} == {"site.json"}
    certificate = folder / "console/console.crt"
    expected = "DNS:twin.example, IP Address:192.168.7.20, IP Address:FD00:0:0:0:0:0:0:7"
    assert expected in alternative_names(certificate)
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    context.load_cert_chain(certificate, folder / "console/console.key")
    make_site.run_tool("openssl", "verify", "-CAfile", folder / "console/ca.crt", "-purpose", "sslserver", certificate)


def test_the_configuration_names_the_folder_on_the_broker(tmp_path):
    make(
        tmp_path / "site",
        *HOST,
        *ROBOT,
        "--broker-folder",
        "/etc/mosquitto/site",
        "--port",
        "9000",
        "--listen",
        "10.0.0.1",
    )
    text = (tmp_path / "site/broker/mosquitto.conf").read_text()
    assert "password_file /etc/mosquitto/site/passwords" in text and "\nlistener 9000 10.0.0.1\n" in text
    assert "allow_anonymous false" in text and "set_tcp_nodelay true" in text and "$" not in text
    assert str(tmp_path) not in text


def verdict(folder: Path, host: str, *more: str) -> tuple[str, str]:
    """Have the CA sign for these hosts; return what openssl and Python's ssl say, empty when they believe it for the first."""
    key, certificate = folder / "tried.key", folder / "tried.crt"
    make_site.sign_server("tried", folder / "tried", (host, *more), folder / "ca/ca")
    command = ["openssl", "verify", "-x509_strict", "-purpose", "sslserver", "-CAfile", folder / "ca/ca.crt"]
    kind = "-verify_hostname" if host.strip("0123456789.") and ":" not in host else "-verify_ip"
    done = subprocess.run([*command, kind, host, certificate], capture_output=True, text=True, check=False)
    own = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    own.load_cert_chain(certificate, key)
    there, back = ssl.MemoryBIO(), ssl.MemoryBIO()
    client = ssl.create_default_context(cafile=folder / "ca/ca.crt").wrap_bio(back, there, server_hostname=host)
    server = own.wrap_bio(there, back, server_side=True)
    said = ""
    for side in (client, server, client):
        try:
            side.do_handshake()
        except ssl.SSLWantReadError:
            pass
        except ssl.SSLCertVerificationError as error:
            said = error.verify_message
    return (done.stderr if done.returncode else ""), said


@pytest.mark.parametrize("host", ["BROKER.example", "a.broker.example", "192.168.7.10", "localhost", "::1"])
def test_the_ca_vouches_for_the_site_s_names(folder, host):
    assert verdict(folder, host) == ("", "")


@pytest.mark.parametrize(
    "hosts",
    [("notbroker.example",), ("example",), ("192.168.7.11",), ("fd00::1",), ("broker.example", "bank.example")],
)  # fmt: skip
def test_nobody_believes_the_ca_about_other_names(folder, hosts):
    openssl, python = verdict(folder, *hosts)
    assert "permitted subtree violation" in openssl and python == "permitted subtree violation"


@pytest.mark.parametrize(
    "arguments, said",
    [
        ([], "--host"),
        (HOST, "--robot"),
        ([*HOST, "--robot", "a/b"], "a/b"),
        (["--host", "300.1.2.3", *ROBOT], "300.1.2.3"),
        (["--host", "a,b", *ROBOT], "a,b"),
        ([*HOST, *ROBOT, "--person", "ada:reset_all"], "look, operate, approve, reset"),
        ([*HOST, *ROBOT, "--person", "ada"], "NAME:RIGHTS"),
    ],
)
def test_what_cannot_work_is_one_sentence(tmp_path, capsys, arguments, said):
    assert main([str(tmp_path / "site"), *arguments]) == 1
    text = capsys.readouterr().out
    assert text.startswith("make_site: ") and text.count("\n") == 1 and said in text


@pytest.mark.parametrize("program, package", [("openssl", "openssl"), ("mosquitto_passwd", "mosquitto")])
def test_a_program_that_is_missing_is_named(tmp_path, monkeypatch, capsys, program, package):
    which = make_site.shutil.which
    monkeypatch.setattr(make_site.shutil, "which", lambda name: None if name == program else which(name))
    assert main([str(tmp_path / "site"), *HOST, *ROBOT]) == 1
    assert f"{program} is not installed; on Debian: apt-get install {package}" in capsys.readouterr().out


def test_a_ca_whose_key_is_gone_is_not_mended_by_making_another(folder, capsys):
    (folder / "ca/ca.key").unlink()
    before = contents(folder)
    assert main([str(folder)]) == 1 and "ca.key is missing" in capsys.readouterr().out
    assert contents(folder) == before


def test_settings_that_cannot_be_read_stop_the_run(folder, capsys):
    for text, said in (
        ("{", "cannot be read"),
        ("[]", "cannot be read"),
        ('{"certificates": false}', "holds certificates"),
    ):
        (folder / "site.json").write_text(text)
        assert main([str(folder)]) == 1 and f"site.json {said}" in capsys.readouterr().out


# -- the account file


def account_file(tmp_path: Path, **document) -> Path:
    path = tmp_path / "account.json"
    path.write_text(json.dumps(document))
    return path


@pytest.mark.parametrize(
    "document, where, expected",
    [
        ({"user": "x"}, "account.json: password_file", "belong together"),
        ({"password_file": "x"}, "account.json: user", "belong together"),
        ({"ca_file": "ca", "cert_file": "x"}, "account.json", "a JSON object of"),
        ({"user": "x", "password": "secret"}, "account.json", "a JSON object of"),
        ({"user": 5, "password_file": "x"}, "account.json", "texts as values"),
    ],
)
def test_an_account_file_that_makes_no_sense_is_refused(tmp_path, document, where, expected):
    with pytest.raises(ConfigurationError, match=f"{where}: .*{expected}"):
        load_account(account_file(tmp_path, **document))


@pytest.mark.parametrize("text", ["", "[]", "user=x", "\x00", "x" * 70000])
def test_a_file_that_is_no_account_is_refused(tmp_path, text):
    path = tmp_path / "account.json"
    path.write_text(text)
    with pytest.raises(ConfigurationError, match=r"account\.json"):
        load_account(path)


def test_files_that_are_missing_or_not_what_they_should_be_are_named(tmp_path):
    path = account_file(tmp_path, user="x", password_file="pw", ca_file="ca.crt")
    with pytest.raises(ConfigurationError, match="/pw: "):
        load_account(path)
    make_site.write_private(tmp_path / "pw", "secret\n")
    with pytest.raises(ConfigurationError, match=r"/ca\.crt: "):
        load_account(path)
    (tmp_path / "ca.crt").write_text("no certificate")
    with pytest.raises(ConfigurationError, match=r"/ca\.crt.*PEM certificates of the broker's CA"):
        load_account(path)


@pytest.mark.parametrize("mode", [0o640, 0o604])
def test_a_secret_that_others_may_read_is_refused(folder, mode):
    account = load_account(folder / "accounts/kr120-bridge/account.json")
    Path(account.password_file).chmod(mode)
    with pytest.raises(ConfigurationError, match=f"chmod 600 {account.password_file}"):
        account.password()


def test_old_tls_is_not_spoken(folder):
    context = load_account(folder / "accounts/kr120-bridge/account.json").context()
    assert context.minimum_version >= ssl.TLSVersion.TLSv1_2 and context.verify_mode is ssl.CERT_REQUIRED


@pytest.mark.parametrize("key", ["password_file", "acl_file", "keyfile"])
def test_a_start_without_a_file_of_its_configuration_is_refused_by_that_files_name(tmp_path, key):
    make(tmp_path, *HOST, *ROBOT)
    conf = tmp_path / "broker" / "mosquitto.conf"
    named = next(line.partition(" ")[2] for line in conf.read_text().splitlines() if line.startswith(f"{key} "))
    check(str(conf), 18830)
    Path(named).unlink()
    with pytest.raises(ConfigurationError, match=f"found '{named}', expected a file that this user can read"):
        check(str(conf), 18830)
