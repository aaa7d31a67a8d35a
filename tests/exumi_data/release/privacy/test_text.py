import pytest

from exumi_data.release.privacy.documents import Removal, without_private_fields
from exumi_data.release.privacy.kinds import Kind
from exumi_data.release.privacy.text import account_names, matches_in

HOME = "/".join(["", "home", "ada"])


@pytest.mark.parametrize(
    ("text", "kind", "part", "instead"),
    [
        (f"{HOME}/clips/a.mov", "path", f"{HOME}/clips/a.mov", "a.mov"),
        (f"{HOME}/my clips/a b.mov", "path", f"{HOME}/my clips/a b.mov", "a b.mov"),
        ("exumi convert /data/in out --fast", "path", "/data/in", "in"),
        ("written to ~/recordings/today.", "path", "~/recordings/today", "today"),
        ("file:///mnt/nas/a.bin", "path", "file:///mnt/nas/a.bin", "a.bin"),
        ("see /srv/rig/rig.toml, please", "path", "/srv/rig/rig.toml", "rig.toml"),
        (HOME, "path", HOME, "removed"),
        ("from C:\\Users\\ada\\x.csv", "path", "C:\\Users\\ada\\x.csv", "x.csv"),
        ("\\\\nas\\share\\x.csv", "path", "\\\\nas\\share\\x.csv", "x.csv"),
        ("/dev/serial/by-id/usb-FTDI_A5028-if00", "serial", None, "removed"),
        ("mac 00:1b:44:11:3a:b7", "serial", "00:1b:44:11:3a:b7", "removed"),
        ("by Ada <ada@lab.example.org>", "email", "ada@lab.example.org", "removed"),
        ("scp ada@rig7:clips .", "host", "ada@rig7", "removed"),
        ("tracker at 192.168.7.31:9000", "host", "192.168.7.31", "removed"),
        ("http://hub.local/x", "host", "hub.local", "removed"),
        ("at +48.1374+011.5755/", "gps", "+48.1374+011.5755/", "removed"),
        ("lat 48.1374", "gps", "lat 48.1374", "removed"),
    ],
)
def test_what_is_private(text: str, kind: str, part: str | None, instead: str) -> None:
    (match,) = matches_in(text)
    found = (match.kind, text[match.start : match.stop], match.instead)
    assert found == (kind, text if part is None else part, instead)


@pytest.mark.parametrize(
    "text",
    [
        "m/s and rad/s, N/m",
        "left/right/both",
        "2023-12-06/golf_ball_3.avi",
        "streams/rgb/data/c/0",
        "https://acme.example/home/smell.json",
        "/dev/video0",
        "/dev/i2c-1",
        "60000/1001",
        "exumi-activity/1",
        "Lavf58.29.100",
        "firmware H19.03.01.30.00",
        "127.0.0.1:8080",
        "version 1.2.3.4.5",
        "10:31:07;12",
        "2026-03-01T12:00:00Z",
        "7d8f0a52-5a5b-4a0e-9d7c-3f2f6a1c9e10",
        "git@github.com",
        "+0.5-1.2",
        "a ratio of 3/4/5",
        "x ~/ y",
        "numbers of force_N were rounded to float32",
        "#/attributes/exumi",
    ],
)
def test_what_is_not(text: str) -> None:
    assert matches_in(text) == []


def test_names_that_are_known_to_be_private() -> None:
    text = f"ada and adam met {HOME}/x"
    found = [text[m.start : m.stop] for m in matches_in(text, {"ada": "user"})]
    assert found == ["ada", f"{HOME}/x"]
    assert account_names(f"{HOME}/x C:\\Users\\bob\\y {HOME.replace('ada', 'ubuntu')}/z") == {
        "ada",
        "bob",
    }


def test_names_in_other_letters_and_words_that_look_like_names() -> None:
    names: dict[str, Kind] = {"Mark": "operator", "Ada Lovelace": "operator", "zelda": "operator"}
    text = "Mark and MARK mark it, as ada lovelace, Zelda and zelda do; Markus does not"
    found = [text[one.start : one.stop] for one in matches_in(text, names)]
    assert found == ["Mark", "MARK", "ada lovelace", "Zelda", "zelda"]


@pytest.mark.parametrize(
    ("said", "kind"),
    [
        ({"operator": {"name": "Ada Lovelace", "age": 36}}, "operator"),
        ({"lab:operators": ["Ada Lovelace", "Grace Hopper"]}, "operator"),
        ({"recorded_by": "Ada Lovelace"}, "operator"),
        ({"serials": ["C34-1", "C34-2"]}, "serial"),
        ({"serial_numbers": [12345678]}, "serial"),
        ({"lat": 48.137}, "gps"),
        ({"GPSLongitude": 11.5}, "gps"),
        ({"gps_track": [[48.1, 11.5]]}, "gps"),
    ],
)
def test_fields_of_third_parties_in_whatever_form(said: dict[str, object], kind: Kind) -> None:
    found: list[Kind] = []

    def take(kind: Kind, *_: object, **__: object) -> bool:
        found.append(kind)
        return True

    assert without_private_fields(said, "zarr.json", take) == {}
    assert found == [kind]
    within = {"calibration": [{"serial": {"read": True}}]}  # what has fields is no serial
    assert without_private_fields(within, "zarr.json", take) == within


@pytest.mark.parametrize(
    ("name", "text", "found"),
    [
        (
            "José",
            "by Jose\N{COMBINING ACUTE ACCENT}, then left",
            ["Jose\N{COMBINING ACUTE ACCENT}"],
        ),
        ("Jose\N{COMBINING ACUTE ACCENT}", "by José.", ["José"]),
        ("Zoë Müller", "ZOË MÜLLER and Zoe Muller", ["ZOË MÜLLER", "Zoe Muller"]),
        ("Straßer", "STRASSER", ["STRASSER"]),
        ("Lovelace", "lovelace, LOVELACE and Lovelaces", ["lovelace", "LOVELACE"]),
        ("Éva", "Évariste and ÉVA", ["ÉVA"]),
        ("李小龙", "李小龙 was there", ["李小龙"]),
        ("Ada Lovelace", "Lovelace pressed; Ada and ADA LOVELACE", ["Lovelace", "ADA LOVELACE"]),
        ("Ada Lovelace", "Lovelaces, in lovelace and self-Lovelace", ["Lovelace"]),
        ("ada lovelace", "lovelace and Lovelace", ["lovelace", "Lovelace"]),
        ("Grace Hopper", "grace and a hopper; Grace, and Hopper's", ["Grace", "Hopper"]),
        ("operator three", "Operator three; three of the Operator", ["Operator three"]),
        ("Anne-Marie O'Brien", "Anne-Marie, O’Brien, Marie", ["Anne-Marie"]),
        ("rig 7 Berlin", "in Berlin", []),
    ],
)
def test_names_in_other_forms_and_in_part(name: str, text: str, found: list[str]) -> None:
    assert [text[one.start : one.stop] for one in matches_in(text, {name: "operator"})] == found


@pytest.mark.parametrize(
    ("name", "text", "found"),
    [
        ("Anna Kowalska", "anna_kowalska_take1", ["anna_kowalska"]),
        ("Anna Kowalska", "2026_Kowalska_03.mp4", ["Kowalska"]),
        ("Anna Kowalska", "Anna_Kowalska mug", ["Anna_Kowalska"]),
        ("Anna Kowalska", "kowalska2.mp4, kowalska.mp4", ["kowalska", "kowalska"]),
        ("Anna Kowalska", "AnnaKowalska3 and AnnaKowalskaX", ["AnnaKowalska"]),
        ("Anna Kowalska", "--operator=anna-kowalska", ["anna-kowalska"]),
        ("p01", "p01_take3.mp4, P01take5, p011, xp01", ["p01", "P01"]),
        ("Zoë Müller", "zoe_muller_1", ["zoe_muller"]),
        ("pilot 7 1", "pilot7_1, pilot 71, pilot 7.1", ["pilot7_1"]),
        # Codes, numbers, units and words.
        ("Ada", "ada2026.mp4, 4ada312, 1ada2", ["ada"]),
        ("Ada", "12345678-1ada-4a0e-9d7c-3f2f6a1c9e10", []),
        ("Ada", f"sha256:{'0' * 30}ada{'1' * 31}", []),
        ("e12", "1e12 and 0be12f, by e12", ["e12"]),
        ("12345", "12345Hz, x12345, 12345_a", ["12345"]),
        ("robot", "robot_pose of a robot", ["robot"]),
        ("Jan Left", "left_tactile, tactile_left", []),
        ("Mark", "mark_start, Mark_1", ["Mark"]),
    ],
)
def test_names_as_they_stand_in_names_of_files(name: str, text: str, found: list[str]) -> None:
    assert [text[one.start : one.stop] for one in matches_in(text, {name: "operator"})] == found


def test_a_name_in_a_path_that_is_kept_or_made_shorter() -> None:
    names: dict[str, Kind] = {"Ada Lovelace": "operator"}
    text = "from /data/ada_lovelace/lovelace_1.mp4"
    kept = Removal(frozenset({"operator"}), names=names)
    assert kept.cleaned(text) == "from /data/removed/removed_1.mp4"
    shortened = Removal(frozenset({"operator", "path"}), names=names)
    assert shortened.cleaned(text) == "from removed_1.mp4"
    assert Removal(frozenset({"path"}), names=names).cleaned(text) == "from lovelace_1.mp4"
    document = {"note": text}
    made = without_private_fields(document, "zarr.json", lambda *_, **__: True, kept)
    assert made == {"note": "from /data/removed/removed_1.mp4"}


def test_that_only_operators_have_parts() -> None:
    assert matches_in("in Berlin", {"Old Berlin": "site"}) == []
    (match,) = matches_in("by Lovelace", {"Ada Lovelace": "operator"})
    assert match.why == "a part of the operator's name"


@pytest.mark.parametrize(
    "text",
    [
        "48.13743, 11.57549",
        "-33.85678;151.21530",
        "48.13743 11.57549",
        "48.1374 N 11.5755 E",
        "48.1374N, 11.5755E",
        "N48.1374 E11.5755",
        "48.1374° N, 11.5755° E",
        "48°08'14.7\"N 11°34'31.8\"E",
        "N 48° 08.246' E 011° 34.529'",
    ],
)
def test_positions_as_people_write_them(text: str) -> None:
    for said in (text, f"at ({text})", f"geo:{text}", f"seen at {text}. Fine"):
        (match,) = matches_in(said)
        assert (match.kind, said[match.start : match.stop]) == ("gps", text)


@pytest.mark.parametrize(
    "text",
    [
        "0.12345, 0.54321",
        "12.34567, 8.12345, 3.12345",
        "q = [0.70711, 0.00000, 0.70711, 2.00001]",
        "320.12345, 240.12345",
        "12.34567, 8.12345 mm",
        "12.3456 8.1234 N",
        "48.1, 11.5",
        "12 N 3 E",
        "version 48.13743.11, 57549.1",
        "pressed with 5.1234 N, 3.1 s",
    ],
)
def test_pairs_that_are_no_positions(text: str) -> None:
    assert matches_in(text) == []
