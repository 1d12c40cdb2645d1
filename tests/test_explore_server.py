"""The served page: actions do what commands do, and nothing but the page may ask for them."""

from __future__ import annotations

import dataclasses
import http.client
import json
import socket
import sys
import tempfile
import threading
import time
from contextlib import suppress
from pathlib import Path

import pytest
from browser import chromium, visit
from small_library import NAMES, small_model

from manifold.errors import UsageError
from manifold.fitting.exports import TARGETS
from manifold.plots.explorer import server as explorer_server
from manifold.plots.explorer.actions import SPECTRUM, Context, action
from manifold.plots.explorer.jobs import MOST_WAITING, Queue
from manifold.plots.explorer.server import MOST_FILE, MOST_JSON, ExplorerServer
from manifold.workflows import explore, export_folders

SLEEPS = (sys.executable, "-c", "import time; time.sleep(60)")
WRITES = (
    sys.executable, "-c",
    "import sys; out = [a for a in sys.argv if a.startswith('--output=')][0][9:]; open(out, 'wb').write(b'made')",
)  # fmt: skip
TELLS = (
    sys.executable, "-c",
    "import json, os, time\n"
    "told = int(os.environ['MANIFOLD_PROGRESS'])\n"
    "os.write(told, b'[1, 4, \"reading\"]\\nno progress\\n[]\\n')\n"
    "time.sleep(60)",
)  # fmt: skip
HERE = {"name": "here", "latent": [0.1, -0.2]}


@pytest.fixture
def context(tmp_path):
    (tmp_path / "work").mkdir()
    return Context(tmp_path / "work", tmp_path / "model.h5", tmp_path / "library.zarr", NAMES, 2, True)


@pytest.fixture
def served(context):
    server = ExplorerServer("<p>the page</p>", context, queue=Queue(context.folder, WRITES))
    thread = threading.Thread(target=server.serve_forever, args=[0.01], daemon=True)
    thread.start()
    yield server
    server.shutdown()
    server.server_close()


def request(server, method, path, body=None, **headers):
    """Status and content of an answer; headers of an honest page by default."""
    host = f"127.0.0.1:{server.server_port}"
    given = {
        "Host": host, "Origin": f"http://{host}", "X-Token": server.token, "Content-Type": "application/json",
    } | {name.replace("_", "-"): value for name, value in headers.items()}  # fmt: skip
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=10)
    content = json.dumps(body).encode() if isinstance(body, dict) else body
    connection.request(method, path, content, {name: v for name, v in given.items() if v is not None})
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    return answer.status, content


def finished(server, number, seconds=60.0):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        job = next(j for j in server.queue.jobs() if j.number == number)
        if job.ended is not None:
            return job
        time.sleep(0.02)
    raise AssertionError(f"still {job.state} after {seconds} s")


def files(context):
    return sorted(path.name for path in context.folder.parent.rglob("*") if path.is_file())


def test_an_honest_page_has_its_action_done(served, context):
    status, content = request(served, "POST", "/do/predict", HERE)
    assert status == 202
    assert finished(served, json.loads(content)["number"]).state == "done"
    assert files(context) == ["here_rgb.bsdf"]
    jobs = json.loads(request(served, "GET", "/jobs")[1])["jobs"]
    assert jobs[0]["title"] == "predict here_rgb.bsdf"


def test_a_name_that_is_taken_gets_a_number(served, context):
    for _ in range(3):
        status, content = request(served, "POST", "/do/render", HERE)
        assert status == 202
    finished(served, json.loads(content)["number"])
    assert files(context) == ["here-2.png", "here-3.png", "here.png"]
    assert request(served, "GET", "/picture/1")[1] == b"made"


def test_a_job_tells_how_much_of_it_is_done_and_can_be_cancelled_then(context):
    queue = Queue(context.folder, TELLS)
    job = queue.add(action("predict", HERE, context))
    end = time.monotonic() + 20
    while job.share is None and time.monotonic() < end:
        time.sleep(0.02)
    told = job.to_json()
    assert (told["state"], told["share"], told["stage"]) == ("running", 0.25, "reading")
    assert queue.cancel(job.number)
    while job.ended is None and time.monotonic() < end:
        time.sleep(0.02)
    assert job.state == "cancelled"
    assert job.seconds < 15
    queue.close()


def test_a_file_is_replaced_only_where_that_was_asked_for(served, context):
    out = context.folder / "here.png"
    out.write_bytes(b"old")
    request(served, "POST", "/do/render", HERE | {"replace": False})
    status, content = request(served, "POST", "/do/render", HERE | {"replace": True})
    assert status == 202
    finished(served, json.loads(content)["number"])
    assert files(context) == ["here-2.png", "here.png"]
    assert out.read_bytes() == b"made"
    assert request(served, "POST", "/do/render", HERE | {"replace": "yes"})[0] == 400
    out.unlink()
    out.symlink_to(context.folder.parent / "elsewhere.png")
    assert request(served, "POST", "/do/render", HERE | {"replace": True})[0] == 400


def test_completed_readings_are_replaced_only_where_that_was_asked_for(served, context):
    headers = {"X_Name": "here", "Content_Type": "application/octet-stream"}
    for replace in ("false", "false", "true"):
        content = request(served, "POST", "/do/complete", b"readings", X_Replace=replace, **headers)[1]
        finished(served, json.loads(content)["number"])
    assert files(context) == ["here-2_rgb.bsdf", "here_rgb.bsdf"]
    (context.folder / "here_rgb.png").symlink_to(context.folder.parent / "elsewhere.png")
    assert request(served, "POST", "/do/complete", b"readings", X_Replace="true", **headers)[0] == 400


@pytest.mark.parametrize(
    ("headers", "expected"),
    [
        ({"X_Token": None}, 403),
        ({"X_Token": "wrong"}, 403),
        ({"X_Token": "\xff"}, 403),
        ({"Origin": None}, 403),
        ({"Origin": "null"}, 403),
        ({"Origin": "https://evil.example"}, 403),
        ({"Host": "evil.example"}, 403),
        ({"Host": "evil.example", "Origin": "http://evil.example"}, 403),
        ({"Content_Type": "text/plain"}, 415),
        ({"Content_Length": str(MOST_JSON + 1)}, 413),
        ({"Content_Length": "-1"}, 411),
    ],
)
def test_what_is_not_the_page_is_refused(served, context, headers, expected):
    assert request(served, "POST", "/do/predict", HERE, **headers)[0] == expected
    assert served.queue.jobs() == []
    assert files(context) == []


def raw(server, text, *, seconds=20.0):
    """Everything that is answered to a text, and whether the connection was closed within some seconds."""
    with socket.create_connection(("127.0.0.1", server.server_port), seconds) as connection:
        connection.sendall(text.encode("latin-1"))
        found = b""
        while block := connection.recv(1 << 16):
            found += block
    return found


@pytest.mark.parametrize("twice", ["Host: evil.example", "Origin: https://evil.example"])
def test_a_header_that_is_there_twice_is_none(served, twice):
    host = f"127.0.0.1:{served.server_port}"
    answer = raw(
        served,
        f"POST /do/cancel HTTP/1.1\r\nHost: {host}\r\nOrigin: http://{host}\r\n{twice}\r\nX-Token: {served.token}\r\n"
        "Content-Type: application/json\r\nContent-Length: 2\r\n\r\n{}",
    )
    assert answer.startswith(b"HTTP/1.0 403 ")


@pytest.mark.parametrize(
    ("method", "path", "expected"),
    [
        ("GET", "http://[/", 400), ("GET", "http://evil.example/jobs", 400), ("GET", "/..%2f..%2fjobs", 404),
        ("GET", "/picture/\\\\host\\share", 404), ("GET", "/picture/\x00", 404), ("GET", "/jobs?" + "a" * 70_000, 414),
        ("HEAD", "/", 501), ("OPTIONS", "/do/render", 501), ("PUT", "/x", 501), ("<script>", "/", 501),
    ],
)  # fmt: skip
def test_what_no_page_asks_for_is_answered_by_a_status(served, method, path, expected):
    host = f"127.0.0.1:{served.server_port}"
    answer = raw(served, f"{method} {path} HTTP/1.1\r\nHost: {host}\r\nX-Token: {served.token}\r\n\r\n")
    assert answer.startswith(f"HTTP/1.0 {expected} ".encode())
    assert b"X-Content-Type-Options: nosniff" in answer
    assert b"<" not in answer


def test_headers_that_come_drop_by_drop_do_not_hold_a_connection(served, monkeypatch):
    monkeypatch.setattr(explorer_server, "_SOCKET_S", 0.5)
    began = time.monotonic()
    with socket.create_connection(("127.0.0.1", served.server_port)) as connection, suppress(OSError):
        while time.monotonic() < began + 5.0:
            connection.sendall(b"X")  # an answer, or a reset, ends it
            time.sleep(0.05)
    assert time.monotonic() - began < 4.0  # the loop alone would go on for 5 s
    assert request(served, "GET", "/jobs")[0] == 200


def test_the_page_itself_needs_the_token(served):
    assert request(served, "GET", "/", X_Token=None)[0] == 403
    assert request(served, "GET", f"/?token={served.token}", X_Token=None) == (200, b"<p>the page</p>")
    for path in ("/jobs", "/picture/1", "/../model.h5", "/do/predict"):
        assert request(served, "GET", path, X_Token=None)[0] == 403
        assert request(served, "GET", path)[0] in (200, 404)


@pytest.mark.parametrize(
    "changed",
    [
        {"name": "../out"}, {"name": "/tmp/out"}, {"name": "a/b"}, {"name": "a\\b"}, {"name": ".."}, {"name": "-x"},
        {"name": ""}, {"name": "x" * 61}, {"name": "a\x00b"}, {"name": 3}, {"name": "a\n"},
        {"latent": [1.0]}, {"latent": ["1", "2"]}, {"latent": "--help"}, {"latent": [True, 1]},
        {"latent": [float("nan"), 0.0]}, {"latent": [1e999, 0.0]}, {"latent": f"{NAMES[0]}:nobody:0.5"},
        {"latent": [10**400, 0]}, {"spectrum": [[400, 0.5], [500, 10**400]]},
        {"latent": f"{NAMES[0]}:{NAMES[1]}:1.5"}, {"latent": f"{NAMES[0]}:{NAMES[1]}:x"},
        {"like": "nobody"}, {"like": "--force"}, {"srgb": "red"}, {"srgb": "#12345g"},
        {"target": "gltf"}, {"like": NAMES[0], "srgb": "#112233"}, {"spectrum": [[400, 0.5]]},
        {"spectrum": "/etc/passwd"},
        {"spectrum": [[400, 0.5], [500, "x"]]}, {"output": "/tmp/out"}, {"model": "/etc/passwd"},
    ],
    ids=str,
)  # fmt: skip
def test_hostile_requests_are_refused(served, context, changed):
    assert request(served, "POST", "/do/predict", HERE | changed)[0] == 400
    assert served.queue.jobs() == []
    assert files(context) == []


def test_a_place_between_two_materials_is_passed_on(context):
    place = f"{NAMES[0]}:{NAMES[1]}:0.25"
    assert f"--latent={place}" in action("predict", HERE | {"latent": place}, context).arguments
    named = dataclasses.replace(context, names=("lab:red", "lab:blue"))
    place = "lab:red:lab:blue:0.25"
    assert f"--latent={place}" in action("predict", HERE | {"latent": place}, named).arguments


@pytest.mark.parametrize("body", [b"", b"[1]", b"{", b"[" * 100_000, b"\xff\xfe", b'{"name": 1e400}'])
def test_bodies_that_are_no_request_are_refused(served, body):
    assert request(served, "POST", "/do/predict", body)[0] == 400


@pytest.mark.parametrize("path", ["/do/", "/do/embed", "/do/../predict", "/do/predict/x", "/", "/do/serve"])
def test_other_actions_are_refused(served, path):
    assert request(served, "POST", path, HERE)[0] in (400, 404)


@pytest.mark.parametrize(
    "changed",
    [{}, {"target": "obj"}, {"target": ["gltf"]}, {"target": "--force"}, {"target": "gltf", "direct": "yes"}],
    ids=str,
)
def test_hostile_exports_are_refused(served, context, changed):
    assert request(served, "POST", "/do/export", HERE | changed)[0] == 400
    assert served.queue.jobs() == []


def test_an_export_is_called_by_its_target(served, context):
    for target in ("gltf", "unity", "unreal"):
        status, content = request(served, "POST", "/do/export", HERE | {"target": target, "direct": True})
        assert status == 202
    finished(served, json.loads(content)["number"])
    assert files(context) == ["here-2.json", "here.glb", "here.json"]
    asked = served.queue.jobs()[0].action.arguments
    assert {"--target=gltf", "--direct", "--json=-"} < set(asked)


def test_a_fit_of_the_page_is_found_by_an_export_of_its_folder(context):
    found = action("fit", HERE, context).output
    found.write_text("{}")
    (outcome,) = export_folders.export_all(context.folder, TARGETS["gltf"], context.folder / "out")
    assert "here.fit.json" in outcome.failure  # is no fit, but was looked at


@pytest.mark.parametrize(
    "name", [None, "", "../out", "/etc/passwd", "a\\b", "--force", "x" * 61, "\xe9", "a b"]
)
def test_readings_need_a_plain_name(served, context, name):
    assert request(served, "POST", "/do/complete", b"Geometry,400\n", X_Name=name)[0] == 400
    assert served.queue.jobs() == []
    assert files(context) == []


@pytest.mark.parametrize("sample", ["a%0Ab", "%00", "x" * 201])
def test_samples_are_names(served, sample):
    headers = {"X_Name": "fine", "X_Sample": sample}
    assert request(served, "POST", "/do/complete", b"Geometry,400\n", **headers)[0] == 400
    assert served.queue.jobs() == []


def test_dropped_readings_are_completed_under_their_name_and_thrown_away(served, context):
    (context.folder / "sample_rgb.png").write_bytes(b"of somebody")
    headers = {"X_Name": "sample", "X_Sample": "r%C3%A9d%20--force"}
    status, content = request(served, "POST", "/do/complete", b"Geometry,400\n", **headers)
    assert status == 202
    job = finished(served, json.loads(content)["number"])
    assert job.state == "done"
    assert files(context) == ["sample-2_rgb.bsdf", "sample_rgb.png"]
    assert {"--picture", "--sample=réd --force"} < set(job.action.arguments)
    assert not Path(job.action.arguments[1]).exists()


def test_a_file_that_is_being_dropped_is_removed_with_the_server(context, monkeypatch, tmp_path):
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    server = ExplorerServer("", context, queue=Queue(context.folder, SLEEPS))
    threading.Thread(target=server.serve_forever, args=[0.01], daemon=True).start()
    host = f"127.0.0.1:{server.server_port}"
    headers = (
        f"Host: {host}\r\nOrigin: http://{host}\r\nX-Token: {server.token}\r\nX-Name: x\r\nContent-Length: 9"
    )
    with socket.create_connection(("127.0.0.1", server.server_port)) as connection:
        connection.sendall(f"POST /do/locate HTTP/1.1\r\n{headers}\r\n\r\nhalf".encode())
        while not any(path.is_file() for path in (tmp_path / "temporary").rglob("*")):
            time.sleep(0.01)
        server.shutdown()
        server.server_close()
        assert list((tmp_path / "temporary").iterdir()) == []


def test_parallel_requests_of_one_name_get_names_of_their_own(context):
    server = ExplorerServer("", context, queue=Queue(context.folder, SLEEPS))
    threading.Thread(target=server.serve_forever, args=[0.01], daemon=True).start()
    threads = [threading.Thread(target=request, args=(server, "POST", "/do/render", HERE)) for _ in range(20)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    outputs = [job.action.output for job in server.queue.jobs()]
    server.shutdown()
    server.server_close()
    assert len(set(outputs)) == len(outputs) == 20


def test_huge_files_are_refused_before_they_are_read(served):
    assert (
        request(served, "POST", "/do/locate", b"x", X_Name="x", Content_Length=str(MOST_FILE + 1))[0] == 413
    )


def test_a_link_in_the_folder_is_not_written_through(served, context, tmp_path):
    (context.folder / "here_rgb.bsdf").symlink_to(tmp_path / "outside")
    number = json.loads(request(served, "POST", "/do/predict", HERE)[1])["number"]
    finished(served, number)
    assert not (tmp_path / "outside").exists()
    assert (context.folder / "here-2_rgb.bsdf").exists()


def test_only_the_loopback_interface_is_listened_on(served):
    assert served.server_address[0] == "127.0.0.1"


def test_slow_and_broken_connections_leave_the_server_alive(served):
    held = []
    for _ in range(8):
        connection = socket.create_connection(("127.0.0.1", served.server_port))
        connection.sendall(b"POST /do/predict HTTP/1.1\r\nContent-Length: 100\r\n")
        held.append(connection)
    held[0].close()
    assert request(served, "GET", "/jobs")[0] == 200
    for connection in held:
        connection.close()


def test_a_hundred_renders_are_queued_or_refused_and_can_be_cancelled(context):
    server = ExplorerServer("", context, queue=Queue(context.folder, SLEEPS))
    threading.Thread(target=server.serve_forever, args=[0.01], daemon=True).start()
    statuses = [request(server, "POST", "/do/render", HERE)[0] for _ in range(100)]
    assert statuses.count(202) in (MOST_WAITING, MOST_WAITING + 1)
    assert set(statuses) == {202, 400}
    running = server.queue.jobs()[0]
    assert request(server, "POST", "/do/cancel", {"number": running.number})[1] == b'{"cancelled": true}'
    assert finished(server, running.number, 10).state == "cancelled"
    for job in server.queue.jobs():
        server.queue.cancel(job.number)
    server.shutdown()
    server.server_close()
    assert all(job.state == "cancelled" for job in server.queue.jobs())
    assert files(context) == []


def test_a_spectrum_reaches_the_command_as_a_file(context):
    script = "import sys; p = [a for a in sys.argv if a.startswith('--reflectance=')][0][14:]; print(open(p).read())"
    queue = Queue(context.folder, (sys.executable, "-c", script))
    asked = action("predict", HERE | {"spectrum": [[400, 0.25], [700, 1]]}, context)
    assert SPECTRUM in asked.arguments
    job = queue.add(asked)
    while job.ended is None:
        time.sleep(0.02)
    queue.close()
    assert job.words == "400.0 0.25\n700.0 1.0"


def test_a_taken_port_is_named(served, context):
    with pytest.raises(UsageError, match=f"port {served.server_port} cannot be listened on"):
        ExplorerServer("", context, served.server_port, queue=Queue(context.folder, WRITES))


@pytest.mark.slow
def test_a_page_writes_the_prediction_and_finds_a_dropped_file(tmp_path):
    server = explore.server(small_model(tmp_path), folder=tmp_path)
    threading.Thread(target=server.serve_forever, args=[0.01], daemon=True).start()
    with chromium() as browser:
        made = visit(browser, server.address)
        page = made.page
        page.set_default_timeout(90_000)
        page.locator("#action-name").fill("mine")
        page.locator("#do-predict").press("Enter")
        page.locator("#jobs li[data-state=done]", has_text="mine_rgb.bsdf").wait_for()
        page.locator("#locate-file").set_input_files(str(tmp_path / "mine_rgb.bsdf"))
        page.locator("#jobs button", has_text="Go to").click()
        x = page.evaluate("window.explorer.state.x")
        assert len(x) == 2
        page.locator("#export-target").select_option("unreal")
        page.locator("#do-export").press("Enter")
        page.locator("#jobs li[data-state=done]", has_text="mine.json").wait_for()
        assert "CIEDE2000" in page.locator("#jobs li", has_text="export mine.json").text_content()
        rows = "Geometry,450,550,650\n" + "".join(f"45as{a},0.1,0.2,0.5\n" for a in (15, 25, 45, 75, 110))
        page.locator("#complete-file").set_input_files(
            {"name": "my readings.csv", "mimeType": "text/csv", "buffer": rows.encode()}
        )
        page.locator("#jobs li[data-state=done]", has_text="complete my-readings_rgb.bsdf").wait_for()
        page.locator("#jobs img[alt*='my-readings']").wait_for()
        page.locator("#action-name").fill("../mine")
        page.locator("#do-render").click()
        page.locator("#problem", has_text="name: expected letters").wait_for()
        assert [text for text in made.errors if not text.startswith("400 ")] == []
        assert all(address.startswith(f"http://127.0.0.1:{server.server_port}/") for address in made.requests)
    server.shutdown()
    server.server_close()
    assert (tmp_path / "mine_rgb.bsdf").exists()
