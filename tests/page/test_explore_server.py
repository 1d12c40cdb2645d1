"""The served page: actions do what commands do, and nothing but the page may request them."""

from __future__ import annotations

import dataclasses
import http.client
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from helpers.browser import chromium, control, visit
from helpers.small_library import NAMES, small_model

from manifold.batch import batch
from manifold.errors import UsageError
from manifold.fit import exporting
from manifold.fit.exports import TARGETS
from manifold.page import explore
from manifold.page.actions import Action, Context, action
from manifold.page.jobs import Queue
from manifold.page.server import MOST_FILE, MOST_JSON, ExplorerServer

SLEEPS = (sys.executable, "-c", "import time; time.sleep(60)")
WRITES = (
    sys.executable, "-c",
    "import sys; out = [a for a in sys.argv if a.startswith('--output=')][0][9:]; open(out, 'wb').write(b'made')",
)  # fmt: skip
REPORTS = (
    sys.executable, "-c",
    "import os, time\n"
    "os.write(int(os.environ['MANIFOLD_PROGRESS']), b'[1, 4, \"reading\"]\\n')\n"
    "time.sleep(60)",
)  # fmt: skip
HERE = {"name": "here", "latent": [0.1, -0.2]}


@pytest.fixture
def context(tmp_path):
    (tmp_path / "work").mkdir()
    return Context(tmp_path / "work", tmp_path / "model.h5", tmp_path / "library.zarr", NAMES, 2, True)


@pytest.fixture
def serve(context):
    """Start servers whose commands are replaced; all end with the test."""
    started = []

    def start(command):
        server = ExplorerServer("<p>the page</p>", context, queue=Queue(context.folder, command))
        threading.Thread(target=server.serve_forever, args=[0.01], daemon=True).start()
        started.append(server)
        return server

    yield start
    for server in started:
        server.shutdown()
        server.server_close()


@pytest.fixture
def served(serve):
    return serve(WRITES)


def request(server, method, path, body=None, **headers):
    """Status and content of an answer; headers of the page by default."""
    host = f"127.0.0.1:{server.server_port}"
    given = {"Host": host, "Origin": f"http://{host}", "X-Token": server.token} | {
        name.replace("_", "-"): value for name, value in headers.items()
    }
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=10)
    content = json.dumps(body).encode() if isinstance(body, dict) else body
    connection.request(method, path, content, {name: v for name, v in given.items() if v is not None})
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    return answer.status, content


def wait_until(is_true, seconds=60.0):
    end = time.monotonic() + seconds
    while not is_true() and time.monotonic() < end:
        time.sleep(0.02)
    assert is_true()


def finished(job):
    wait_until(lambda: job.ended is not None)
    return job


def post(server, path, body, **headers):
    """The finished job of a request that is accepted."""
    status, content = request(server, "POST", path, body, **headers)
    assert status == 202
    return finished(server.queue.jobs[json.loads(content)["number"] - 1])


def files(context):
    return sorted(path.name for path in context.folder.parent.rglob("*") if path.is_file())


def test_a_request_of_the_page_runs_its_command(served, context):
    assert post(served, "/do/predict", HERE).state == "done"
    assert files(context) == ["here_rgb.bsdf"]
    jobs = json.loads(request(served, "GET", "/jobs")[1])["jobs"]
    assert [(job["title"], job["state"]) for job in jobs] == [("predict here_rgb.bsdf", "done")]


def test_a_name_that_is_taken_gets_a_number_unless_its_file_may_be_replaced(served, context):
    (context.folder / "here.png").write_bytes(b"old")
    assert post(served, "/do/render", HERE).has_picture
    assert request(served, "GET", "/picture/1")[1] == b"made"
    post(served, "/do/render", HERE | {"replace": True})
    assert files(context) == ["here-2.png", "here.png"]
    assert (context.folder / "here.png").read_bytes() == b"made"
    for replace in ("false", "false", "true"):
        post(served, "/do/complete", b"readings", X_Name="here", X_Replace=replace)
    assert files(context) == ["here-2.png", "here-2_rgb.bsdf", "here.png", "here_rgb.bsdf"]


def test_a_job_reports_its_progress_and_can_be_cancelled(context):
    queue = Queue(context.folder, REPORTS)
    job = queue.add(action("predict", HERE, context, context.folder, Path.exists))
    while job.share is None:
        time.sleep(0.02)
    shown = job.to_json()
    assert (shown["state"], shown["share"], shown["stage"]) == ("running", 0.25, "reading")
    assert queue.cancel(job.number)
    assert finished(job).state == "cancelled"
    assert not queue.cancel(job.number)
    queue.close()


def test_waiting_jobs_can_be_cancelled_and_requests_at_once_get_names_of_their_own(serve, context):
    server = serve(SLEEPS)
    threads = [threading.Thread(target=request, args=(server, "POST", "/do/render", HERE)) for _ in range(20)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len({job.action.output for job in server.queue.jobs}) == 20
    for job in reversed(server.queue.jobs):
        assert request(server, "POST", "/do/cancel", {"number": job.number})[1] == b'{"cancelled": true}'
    assert all(finished(job).state == "cancelled" for job in server.queue.jobs)
    assert files(context) == []


def test_a_module_in_the_output_folder_is_not_imported(context):
    """A page, or somebody else, may have put it there."""
    (context.folder / "random.py").write_text("open('was_run', 'w')")
    dropped = context.folder.parent / "dropped"
    dropped.write_bytes(b"no material")
    queue = Queue(context.folder)
    job = finished(queue.add(Action("locate", ("locate", str(dropped), f"--model={context.model}"))))
    queue.close()
    assert job.state == "failed"
    assert "11 bytes" in job.message
    assert not (context.folder / "was_run").exists()


@pytest.mark.parametrize(
    ("headers", "expected"),
    [
        ({"X_Token": None}, 403),
        ({"X_Token": "wrong"}, 403),
        ({"X_Token": "\xff"}, 403),
        ({"Origin": None}, 403),
        ({"Origin": "null"}, 403),
        ({"Origin": "https://evil.example"}, 403),
        ({"Host": "evil.example", "Origin": "http://evil.example"}, 403),
        ({"Content_Length": str(MOST_JSON + 1)}, 413),
        ({"Content_Length": "-1"}, 411),
    ],
)
def test_what_is_not_the_page_is_refused(served, context, headers, expected):
    assert request(served, "POST", "/do/predict", HERE, **headers)[0] == expected
    assert served.queue.jobs == []
    assert files(context) == list(served.inputs.iterdir()) == []


def test_the_page_itself_needs_the_token(served):
    assert request(served, "GET", f"/?token={served.token}", X_Token=None) == (200, b"<p>the page</p>")
    for path in ("/", "/jobs", "/picture/1", "/../model.h5", "/do/predict"):
        assert request(served, "GET", path, X_Token=None)[0] == 403
        assert request(served, "GET", path)[0] == (200 if path in ("/", "/jobs") else 404)
    assert request(served, "PUT", "/do/render", HERE)[0] == 501


@pytest.mark.parametrize(
    "changed",
    [
        {"name": "../out"}, {"name": "/tmp/out"}, {"name": "a\\b"}, {"name": ".."}, {"name": "-x"},
        {"name": ""}, {"name": "x" * 61}, {"name": "a\x00b"}, {"name": 3}, {"name": "a\n"},
        {"latent": [1.0]}, {"latent": ["1", "2"]}, {"latent": "--help"}, {"latent": [True, 1]},
        {"latent": [float("nan"), 0.0]}, {"latent": [1e999, 0.0]}, {"latent": f"{NAMES[0]}:nobody:0.5"},
        {"latent": [10**400, 0]}, {"latent": f"{NAMES[0]}:{NAMES[1]}:1.5"}, {"latent": None},
        {"like": "nobody"}, {"like": "--force"}, {"srgb": "red"}, {"srgb": "#12345g"}, {"srgb": "#123456\n"},
        {"target": "gltf"}, {"like": NAMES[0], "srgb": "#112233"}, {"spectrum": [[400, 0.5]]},
        {"spectrum": "/etc/passwd"}, {"spectrum": [[400, 0.5], [500, "x"]]}, {"spectrum": [[400, 0.5], [500, 1e999]]},
        {"output": "/tmp/out"}, {"model": "/etc/passwd"}, {"replace": "yes"},
    ],
    ids=str,
)  # fmt: skip
def test_hostile_requests_are_refused(served, context, changed):
    assert request(served, "POST", "/do/predict", HERE | changed)[0] == 400
    assert served.queue.jobs == []
    assert files(context) == list(served.inputs.iterdir()) == []


@pytest.mark.parametrize(
    "changed",
    [{}, {"target": "obj"}, {"target": ["gltf"]}, {"target": "--force"}, {"target": "gltf", "direct": "yes"}],
    ids=str,
)
def test_hostile_exports_are_refused(served, changed):
    assert request(served, "POST", "/do/export", HERE | changed)[0] == 400
    assert served.queue.jobs == []


@pytest.mark.parametrize(
    "body", [b"", b"[1]", b"{", b"[" * 100_000, b"\xff\xfe", b'{"name": "a", "latent": 1e400}']
)
def test_bodies_that_are_no_request_are_refused(served, body):
    assert request(served, "POST", "/do/predict", body)[0] == 400


@pytest.mark.parametrize("path", ["/do/", "/do/embed", "/do/../predict", "/do/predict/x", "/", "/do/serve"])
def test_other_actions_are_refused(served, path):
    assert request(served, "POST", path, HERE)[0] == 400


def test_a_place_between_two_materials_is_passed_on(context):
    named = dataclasses.replace(context, names=("lab:red", "lab:blue"))
    for names, known in ((NAMES, context), (named.names, named)):
        place = f"{names[0]}:{names[1]}:0.25"
        asked = action("predict", HERE | {"latent": place}, known, context.folder, Path.exists)
        assert f"--latent={place}" in asked.arguments


def test_an_export_is_named_after_its_target(served, context):
    for target in ("gltf", "unity", "unreal"):
        job = post(served, "/do/export", HERE | {"target": target, "direct": True})
    assert files(context) == ["here-2.json", "here.glb", "here.json"]
    assert {"--target=unreal", "--json=-"} < set(job.action.arguments)


def test_a_fit_of_the_page_is_found_by_an_export_of_its_folder(context):
    action("fit", HERE, context, context.folder, Path.exists).output.write_text("{}")
    (outcome,) = batch(
        exporting.exports(TARGETS["gltf"]), exporting.export_sources(context.folder), context.folder / "out"
    ).outcomes
    assert "here.fit.json" in outcome.failure  # which says that it is no fit


@pytest.mark.parametrize(
    "headers",
    [
        *({"X_Name": name} for name in (None, "", "../out", "/etc/passwd", "a\\b", "--force", "x" * 61, "\xe9", "a b")),
        *({"X_Name": "fine", "X_Sample": sample} for sample in ("a%0Ab", "%00", "x" * 201)),
        {"X_Name": "fine", "Content_Length": str(MOST_FILE + 1)},
    ],
    ids=str,
)  # fmt: skip
def test_files_need_plain_names_and_have_a_limit(served, context, headers):
    assert request(served, "POST", "/do/complete", b"Geometry,400\n", **headers)[0] in (400, 413)
    assert served.queue.jobs == []
    assert files(context) == list(served.inputs.iterdir()) == []


def test_dropped_readings_are_completed_under_their_name_and_removed(served, context):
    (context.folder / "sample_rgb.png").write_bytes(b"of somebody")
    job = post(served, "/do/complete", b"Geometry,400\n", X_Name="sample", X_Sample="r%C3%A9d%20--force")
    assert job.state == "done"
    assert files(context) == ["sample-2_rgb.bsdf", "sample_rgb.png"]
    assert {"--picture", "--sample=réd --force"} < set(job.action.arguments)
    served.queue.close()
    assert list(served.inputs.iterdir()) == []


def test_a_dropped_photograph_and_its_light_are_located(serve):
    script = (
        "import sys; from pathlib import Path\n"
        "value = {a.split('=')[0]: a.split('=', 1)[1] for a in sys.argv if '=' in a}\n"
        "print(*(Path(value[key]).name + ' ' + Path(value[key]).read_text() for key in ('--photo', '--light')))"
    )
    server = serve((sys.executable, "-c", script))
    taken = {"suffix": ".jpg", "light_suffix": ".exr", "light_bytes": 5, "circle": "10,20.5,8", "turn": -30}
    job = post(server, "/do/photograph", b"pixelslight", X_Name="ball", X_Request=json.dumps(taken))
    assert job.message == "ball.jpg pixels ball-light.exr light"
    assert {"--circle=10,20.5,8", "--turn=-30", "--json=-"} < set(job.action.arguments)
    assert job.action.output.name == "ball_photo.png"
    server.queue.close()
    assert not job.action.inputs.exists()


@pytest.mark.parametrize("lamp", ["found", "flash", "0.5,-0.25,1", "0,0,1,12.5", "found,10"])
def test_a_photograph_under_a_lamp_is_located(serve, lamp):
    server = serve((sys.executable, "-c", "print('done')"))
    job = post(
        server,
        "/do/photograph",
        b"pixels",
        X_Name="ball",
        X_Request=json.dumps({"suffix": ".jpg", "lamp": lamp}),
    )
    assert f"--lamp={lamp}" in job.action.arguments
    assert not any(argument.startswith("--light") for argument in job.action.arguments)


@pytest.mark.parametrize(
    "changed",
    [
        {"lamp": "found"}, {"light": None, "lamp": "/etc/passwd"}, {"light": None, "lamp": "0,0,1\n"},
        {"suffix": ".sh"}, {"suffix": "/../x.png"}, {"light": "/etc/passwd"}, {"light": "sky", "light_bytes": 2},
        {"light": None}, {"circle": "1,2"}, {"circle": "1,2,--force"}, {"circle": "1,2,3\n"}, {"turn": "1"},
        {"turn": 1e9}, {"elevation": 90}, {"distance": 0.5}, {"exposure": "--force"}, {"camera": "/etc/passwd"},
    ],
    ids=str,
)  # fmt: skip
def test_hostile_photographs_are_refused(served, context, changed):
    asked = json.dumps({"suffix": ".png", "light": "sky"} | changed)
    assert request(served, "POST", "/do/photograph", b"pixels", X_Name="ball", X_Request=asked)[0] == 400
    for light in ({"light_suffix": ".exr", "light_bytes": 6}, {"light_suffix": ".exr", "light_bytes": 0}):
        asked = json.dumps({"suffix": ".png"} | light)
        assert request(served, "POST", "/do/photograph", b"pixels", X_Name="ball", X_Request=asked)[0] == 400
    assert served.queue.jobs == []
    assert files(context) == list(served.inputs.iterdir()) == []


def test_a_spectrum_reaches_the_command_as_a_file(serve):
    script = "import sys; p = [a for a in sys.argv if a.startswith('--reflectance=')][0][14:]; print(open(p).read())"
    server = serve((sys.executable, "-c", script))
    job = post(server, "/do/predict", HERE | {"spectrum": [[400, 0.25], [700, 1]]})
    assert job.message == "400.0 0.25\n700.0 1.0"
    server.queue.close()
    assert list(server.inputs.iterdir()) == []


def test_a_connection_that_sends_no_more_leaves_the_server_alive(served):
    assert served.server_address[0] == "127.0.0.1"
    with socket.create_connection(("127.0.0.1", served.server_port)) as held:
        held.sendall(b"POST /do/predict HTTP/1.1\r\nContent-Length: 100\r\n")
        assert request(served, "GET", "/jobs")[0] == 200


def test_an_upload_that_breaks_off_leaves_nothing(served):
    head = {"Host": f"127.0.0.1:{served.server_port}", "X-Token": served.token, "X-Name": "sample"}
    head |= {"Origin": f"http://{head['Host']}", "Content-Length": "100"}
    lines = ["POST /do/complete HTTP/1.1", *(f"{name}: {value}" for name, value in head.items()), "", "begun"]
    with socket.create_connection(("127.0.0.1", served.server_port)) as upload:
        upload.sendall("\r\n".join(lines).encode())
        wait_until(lambda: list(served.inputs.rglob("sample")))
    wait_until(lambda: not list(served.inputs.iterdir()))
    assert served.queue.jobs == []


def test_slow_connections_do_not_block_others(served):
    held = []
    for _ in range(40):
        held.append(socket.create_connection(("127.0.0.1", served.server_port)))
        held[-1].sendall(b"POST /do/locate HTTP/1.1\r\nContent-Length: 100\r\n\r\n{")
    assert request(served, "GET", "/jobs")[0] == 200
    assert post(served, "/do/predict", HERE).state == "done"
    for connection in held:
        connection.close()


def test_a_taken_port_is_named(served, context):
    with pytest.raises(UsageError, match=f"port {served.server_port} cannot be listened on"):
        ExplorerServer("", context, served.server_port)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_the_command_that_runs_ends_with_the_server(tmp_path, number):
    script = f"""
import sys, time
from pathlib import Path
from manifold.page.actions import Action, Context
from manifold.page.jobs import Queue
from manifold.page.server import ExplorerServer
from manifold.page.explore import serve_until_interrupted
folder = Path({str(tmp_path)!r})
sleeps = (sys.executable, "-c", "import os, time; open('pid', 'w').write(str(os.getpid())); time.sleep(60)")
server = ExplorerServer("", Context(folder, folder, folder, (), 2, True), queue=Queue(folder, sleeps))
server.queue.add(Action("sleep", ()))
while not (folder / "pid").exists() or not (folder / "pid").read_text():
    time.sleep(0.01)
serve_until_interrupted(server, lambda address: print(server.inputs, flush=True))
"""
    process = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True)
    inputs = process.stdout.readline().strip()
    process.send_signal(number)
    assert process.wait(20) == 0
    process.stdout.close()
    assert not Path(inputs).exists()
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "pid").read_text()), 0)


def test_a_command_ends_when_what_listens_to_its_progress_is_killed(tmp_path):
    """As a server that is killed leaves it; with the processes that it has started."""
    reads, writes = os.pipe()
    command = subprocess.Popen(
        [sys.executable, "-m", "manifold", "corpus", "files"], cwd=tmp_path, pass_fds=[writes],
        env=os.environ | {"MANIFOLD_PROGRESS": str(writes)}, start_new_session=True,
    )  # fmt: skip
    os.close(writes)
    assert os.read(reads, 1)  # it works
    os.close(reads)
    assert command.wait(20) == -signal.SIGTERM


@pytest.mark.slow
def test_a_page_writes_the_prediction_and_finds_a_dropped_file(tmp_path):
    server = explore.server(small_model(tmp_path), folder=tmp_path)
    threading.Thread(target=server.serve_forever, args=[0.01], daemon=True).start()
    with chromium() as browser:
        made = visit(browser, server.address)
        page = made.page
        page.set_default_timeout(90_000)
        control(page, "#action-name").fill("mine")
        control(page, "#do-predict").press("Enter")
        page.locator("#jobs li[data-state=done]", has_text="mine_rgb.bsdf").wait_for()
        control(page, "#locate-file").set_input_files(str(tmp_path / "mine_rgb.bsdf"))
        page.locator("#caption", has_text="mine_rgb").wait_for()
        assert page.evaluate("window.explorer.state.x.length") == 2
        page.evaluate("window.explorer.goTo(0)")
        control(page, "#export-target").select_option("unreal")
        control(page, "#do-export").press("Enter")
        page.locator("#jobs li[data-state=done]", has_text="mine.json").wait_for()
        assert "CIEDE2000" in page.locator("#jobs li", has_text="export mine.json").text_content()
        rows = "Geometry,450,550,650\n" + "".join(f"45as{a},0.1,0.2,0.5\n" for a in (15, 25, 45, 75, 110))
        control(page, "#complete-file").set_input_files(
            {"name": "my readings.csv", "mimeType": "text/csv", "buffer": rows.encode()}
        )
        page.locator("#jobs li[data-state=done]", has_text="complete my-readings_rgb.bsdf").wait_for()
        page.locator("#jobs img[alt*='my-readings']").wait_for(state="attached")
        control(page, "#action-name").fill("../mine")
        control(page, "#do-render").click()
        page.locator("#problem", has_text="name: expected letters").wait_for()
        assert [text for text in made.errors if not text.startswith("400 ")] == []
        assert all(address.startswith(f"http://127.0.0.1:{server.server_port}/") for address in made.requests)
    server.shutdown()
    server.server_close()
    assert (tmp_path / "mine_rgb.bsdf").exists()
