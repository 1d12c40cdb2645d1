"""The served page: actions do what commands do, and nothing but the page may request them."""

from __future__ import annotations

import dataclasses
import http.client
import inspect
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from pkgutil import resolve_name
from urllib.parse import quote

import pytest
from helpers.browser import TIMEOUT_MS, chromium, control, visit
from helpers.small_library import NAMES, small_library, small_model

from manifold.core.errors import UsageError
from manifold.fit import exporting
from manifold.many.batch import batch
from manifold.page import explore
from manifold.page.commands import COMMANDS, Context, call_of
from manifold.page.jobs import Queue
from manifold.page.server import MOST_FILE, MOST_JSON, ExplorerServer
from manifold.registries import TARGETS


def worker(body):
    """A worker whose commands all are these lines."""
    lines = "".join(f"    {line}\n" for line in body.splitlines())
    imports = "import os, time\nfrom manifold.core import progress\nfrom manifold.page.worker import serve\n"
    return (sys.executable, "-c", f"{imports}def run(command, given):\n{lines}serve(run)")


SLEEPS = worker("time.sleep(60)")
WRITES = worker("(given.get('output') or given['path']).write_bytes(b'made')\nreturn {}")
PID = worker("given['path'].write_text(str(os.getpid()))\ntime.sleep(60)")
REPORTS = worker("progress.report(1, 4, 'reading')\ntime.sleep(60)")
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
        server = ExplorerServer("<p>the page</p>", context, queue=Queue(command))
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


def upload(server, path, body, asked):
    """The finished job of a request about a file."""
    return post(server, path, body, X_Request=quote(json.dumps(asked)))


def files(context):
    return sorted(path.name for path in context.folder.parent.rglob("*") if path.is_file())


def test_a_request_of_the_page_runs_its_command(served, context):
    assert post(served, "/do/predict", HERE).state == "done"
    assert files(context) == ["here_rgb.bsdf"]
    (job,) = json.loads(request(served, "GET", "/jobs")[1])["jobs"]
    assert (job["command"], job["subject"], job["state"]) == ("predict", "here_rgb.bsdf", "done")


def test_a_name_that_is_taken_gets_a_number_unless_its_file_may_be_replaced(served, context):
    (context.folder / "here.png").write_bytes(b"old")
    assert post(served, "/do/render", HERE).has_picture
    assert request(served, "GET", "/picture/1")[1] == b"made"
    post(served, "/do/render", HERE | {"replace": True})
    assert files(context) == ["here-2.png", "here.png"]
    assert (context.folder / "here.png").read_bytes() == b"made"
    for replace in (False, False, True):
        upload(served, "/do/complete", b"readings", {"name": "here", "replace": replace})
    assert files(context) == ["here-2.png", "here-3.bsdf", "here-4.bsdf", "here.bsdf", "here.png"]


def test_a_job_reports_its_progress_and_can_be_cancelled(context):
    queue = Queue(REPORTS)
    job = queue.add(call_of("predict", HERE, context, Path.exists))
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
    assert len({job.call.output for job in server.queue.jobs}) == 20
    for job in reversed(server.queue.jobs):
        assert request(server, "POST", "/do/cancel", {"number": job.number})[1] == b'{"cancelled": true}'
    assert all(finished(job).state == "cancelled" for job in server.queue.jobs)
    assert files(context) == []


def test_a_module_in_the_output_folder_is_not_imported(context, monkeypatch):
    """A page, or somebody else, may have put it there."""
    monkeypatch.chdir(context.folder)
    Path("random.py").write_text("open('was_run', 'w')")
    dropped = context.folder.parent / "dropped"
    dropped.write_bytes(b"no material")
    queue = Queue()
    job = finished(queue.add(call_of("locate", {"name": "dropped"}, context, Path.exists, dropped)))
    queue.close()
    assert job.state == "failed"
    assert "11 bytes" in job.message
    assert not Path("was_run").exists()


def test_a_worker_stays_until_it_is_cancelled_or_dies_and_the_next_job_has_another(context):
    queue = Queue(
        worker(
            "if command == 'render': os.kill(os.getpid(), 9)\n"
            "if command == 'fit': raise MemoryError\n"
            "if command == 'export': print('noise'); return {'pid': float('nan')}\n"
            "return {'pid': os.getpid()}"
        )
    )

    def run(name, **more):
        return finished(queue.add(call_of(name, HERE | more, context, Path.exists)))

    first = run("predict").result["pid"]
    assert run("predict").result["pid"] == first
    assert "ValueError" in run("export", target="gltf").message
    assert run("predict").result["pid"] == first
    pids = {first}
    for name, why in (("render", "the worker process ended (status -9"), ("fit", "out of memory")):
        assert why in run(name).message
        pids.add(run("predict").result["pid"])
    os.kill(queue._worker.pid, signal.SIGKILL)  # while it is idle
    queue._worker.wait()
    assert len(pids | {run("predict").result["pid"]}) == 4
    queue.close()


def test_functions_of_commands_take_the_arguments_of_requests(context):
    dropped = context.folder / "dropped"
    fields = {**HERE, "srgb": "#123456", "target": "gltf", "suffix": ".png", "light": "sky"}
    for name, command in COMMANDS.items():
        dropped.touch()
        taken = {key: value for key, value in fields.items() if key in command.schema["properties"]}
        asked = call_of(name, taken, context, Path.exists, dropped)
        bound = inspect.signature(resolve_name(command.function)).bind(**asked.arguments)
        assert bound.arguments, name


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
    assert files(context) == list(served.queue.inputs.iterdir()) == []


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
    assert files(context) == list(served.queue.inputs.iterdir()) == []


@pytest.mark.parametrize(
    "changed",
    [{}, {"target": "obj"}, {"target": ["gltf"]}, {"target": "--force"}, {"target": "gltf", "direct": True}],
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
def test_other_commands_are_refused(served, path):
    assert request(served, "POST", path, HERE)[0] == 400


def test_a_place_between_two_materials_is_passed_on(context):
    named = dataclasses.replace(context, names=("lab:red", "lab:blue"))
    for names, known in ((NAMES, context), (named.names, named)):
        place = f"{names[0]}:{names[1]}:0.25"
        asked = call_of("predict", HERE | {"latent": place}, known, Path.exists)
        assert asked.arguments["latent"] == place


def test_an_export_is_named_after_its_target(served, context):
    for target in ("gltf", "unity", "unreal"):
        job = post(served, "/do/export", HERE | {"target": target})
    assert files(context) == ["here-2.json", "here.glb", "here.json"]
    assert job.call.arguments["target"] == "unreal"


def test_a_fit_of_the_page_is_found_by_an_export_of_its_folder(context):
    call_of("fit", HERE, context, Path.exists).output.write_text("{}")
    (outcome,) = batch(
        exporting.exports(TARGETS["gltf"]), exporting.export_sources(context.folder), context.folder / "out"
    ).outcomes
    assert "here.fit.json" in outcome.failure  # which says that it is no fit


def asking(**fields):
    """The header of a request about a file."""
    return {"X_Request": quote(json.dumps(fields))}


@pytest.mark.parametrize(
    "headers",
    [
        *(asking(name=name) for name in (None, "", "../out", "/etc/passwd", "a\\b", "--force", "x" * 61, "\xe9")),
        *(asking(name="fine", sample=sample) for sample in ("a\nb", "\0", "x" * 201, 7)),
        asking(name="fine", library="/etc"), asking(), {}, {"X_Request": "%ff"}, {"X_Request": "[]"},
        asking(name="fine") | {"Content_Length": str(MOST_FILE + 1)},
    ],
    ids=str,
)  # fmt: skip
def test_files_need_plain_names_and_have_a_limit(served, context, headers):
    assert request(served, "POST", "/do/complete", b"Geometry,400\n", **headers)[0] in (400, 413)
    assert served.queue.jobs == []
    assert files(context) == list(served.queue.inputs.iterdir()) == []


def test_dropped_readings_are_completed_under_their_name_and_removed(served, context):
    (context.folder / "sample.png").write_bytes(b"of somebody")
    job = upload(served, "/do/complete", b"Geometry,400\n", {"name": "sample", "sample": "réd --force"})
    assert job.state == "done"
    assert files(context) == ["sample-2.bsdf", "sample.png"]
    assert job.call.arguments["sample"] == "réd --force"
    wait_until(lambda: not list(served.queue.inputs.iterdir()))


def test_a_dropped_photograph_and_its_light_are_located(serve):
    server = serve(
        worker(
            "from pathlib import Path\n"
            "paths = [*given['request'].photographs, *map(Path, given['request'].lights)]\n"
            "return {path.name: path.read_text() for path in paths}"
        )
    )
    taken = {"suffix": ".jpg", "light_suffix": ".exr", "light_bytes": 5, "circle": "10,20.5,8", "turn": -30}
    job = upload(server, "/do/photograph", b"pixelslight", taken | {"name": "ball"})
    assert job.result == {"ball.jpg": "pixels", "ball-light.exr": "light"}
    asked = job.call.arguments["request"]
    assert (asked.circles, asked.turns_deg, asked.exposure) == (["10,20.5,8"], [-30], 1.0)
    assert job.call.output.name == "ball_photo.png"
    wait_until(lambda: not job.call.inputs.exists())


@pytest.mark.parametrize("lamp", ["found", "flash", "0.5,-0.25,1", "0,0,1,12.5", "found,10"])
def test_a_photograph_under_a_lamp_is_located(context, lamp):
    (context.folder / "ball").write_bytes(b"pixels")
    taken = {"name": "ball", "suffix": ".jpg", "lamp": lamp}
    asked = call_of("photograph", taken, context, Path.exists, context.folder / "ball").arguments["request"]
    assert (asked.lamps, asked.lights, asked.exposure) == ([lamp], [], None)


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
    asked = {"name": "ball", "suffix": ".png", "light": "sky"} | changed
    known = {key: value for key, value in asked.items() if value is not None}
    for body in (
        known,
        *({"name": "ball", "suffix": ".png", "light_suffix": ".exr", "light_bytes": n} for n in (6, 0)),
    ):
        assert request(served, "POST", "/do/photograph", b"pixels", **asking(**body))[0] == 400
    assert served.queue.jobs == []
    assert files(context) == list(served.queue.inputs.iterdir()) == []


def test_a_spectrum_is_checked_and_reaches_the_command(served):
    job = post(served, "/do/predict", HERE | {"spectrum": [[400, 0.25], [700, 1]]})
    spectrum = job.call.arguments["colour"].reflectance
    assert (spectrum.wavelengths_nm, spectrum.values) == ((400.0, 700.0), (0.25, 1.0))
    for rows in ([[700, 0.25], [400, 1]], [[400, 0.25], [700, 2]], [[400, 0.25], [410, 1]]):
        assert request(served, "POST", "/do/predict", HERE | {"spectrum": rows})[0] == 400


def test_a_connection_that_sends_no_more_leaves_the_server_alive(served):
    assert served.server_address[0] == "127.0.0.1"
    with socket.create_connection(("127.0.0.1", served.server_port)) as held:
        held.sendall(b"POST /do/predict HTTP/1.1\r\nContent-Length: 100\r\n")
        assert request(served, "GET", "/jobs")[0] == 200


def test_an_upload_that_breaks_off_leaves_nothing(served):
    head = {
        "Host": f"127.0.0.1:{served.server_port}",
        "X-Token": served.token,
        "X-Request": quote('{"name": "sample"}'),
    }
    head |= {"Origin": f"http://{head['Host']}", "Content-Length": "100"}
    lines = ["POST /do/complete HTTP/1.1", *(f"{name}: {value}" for name, value in head.items()), "", "begun"]
    with socket.create_connection(("127.0.0.1", served.server_port)) as upload:
        upload.sendall("\r\n".join(lines).encode())
        wait_until(lambda: list(served.queue.inputs.rglob("sample")))
    wait_until(lambda: not list(served.queue.inputs.iterdir()))
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


def test_files_of_a_page_do_not_go_into_a_library(tmp_path):
    with pytest.raises(UsageError, match="in the library"):
        explore.server(small_model(tmp_path), folder=small_library(tmp_path))


def test_a_taken_port_is_named(served, context):
    with pytest.raises(UsageError, match=f"cannot listen on port {served.server_port}"):
        ExplorerServer("", context, served.server_port)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize("signals", [1, 3])
def test_the_command_that_runs_ends_with_the_server(tmp_path, number, signals):
    script = f"""
import sys, time
from pathlib import Path
from manifold.page.commands import Call, Context
from manifold.page.jobs import Queue
from manifold.page.server import ExplorerServer
from manifold.page.explore import serve_until_interrupted
folder = Path({str(tmp_path)!r})
server = ExplorerServer("", Context(folder, folder, folder, (), 2, True), queue=Queue({PID!r}))
server.queue.add(Call("sleep", "", {{"path": folder / "pid"}}))
while not (folder / "pid").exists() or not (folder / "pid").read_text():
    time.sleep(0.01)
serve_until_interrupted(server, lambda address: print(server.queue.inputs, flush=True))
"""
    process = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True)
    inputs = process.stdout.readline().strip()
    for _ in range(signals):
        process.send_signal(number)
        time.sleep(0.01)
    status = process.wait(20)
    assert status == 0 or signals > 1  # a later one may meet the end of the interpreter
    process.stdout.close()
    assert not Path(inputs).exists()
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "pid").read_text()), 0)


def test_the_worker_ends_when_the_server_is_killed(tmp_path):
    """With the processes that it has started, and the files that were sent."""
    script = f"""
from pathlib import Path
from manifold.page.commands import Call
from manifold.page.jobs import Queue
queue = Queue({PID!r})
queue.add(Call("sleep", "", {{"path": Path({str(tmp_path / "pid")!r})}}))
print(queue.inputs, flush=True)
"""
    server = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True)
    inputs = Path(server.stdout.readline().strip())
    wait_until(lambda: (tmp_path / "pid").exists() and (tmp_path / "pid").read_text())
    server.kill()
    server.wait()
    server.stdout.close()
    wait_until(lambda: not inputs.exists())
    wait_until(lambda: not Path(f"/proc/{(tmp_path / 'pid').read_text()}").exists())


def test_idle_worker_removes_the_files_of_a_killed_server():
    script = "from manifold.page.jobs import Queue; queue = Queue(); print(queue.inputs, flush=True); input()"
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    server = subprocess.Popen([sys.executable, "-c", script], text=True, **pipes)
    inputs = Path(server.stdout.readline().strip())
    assert inputs.exists()
    server.kill()
    server.communicate()
    wait_until(lambda: not inputs.exists())


@pytest.mark.slow
def test_a_page_writes_the_prediction_and_finds_a_dropped_file(tmp_path):
    server = explore.server(small_model(tmp_path), folder=tmp_path)
    threading.Thread(target=server.serve_forever, args=[0.01], daemon=True).start()
    with chromium() as browser:
        made = visit(browser, server.address)
        page = made.page
        page.set_default_timeout(TIMEOUT_MS)
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
        page.locator("#jobs li[data-state=done]", has_text="complete my-readings.bsdf").wait_for()
        page.locator("#jobs img[alt*='my-readings']").wait_for(state="attached")
        control(page, "#action-name").fill("../mine")
        control(page, "#do-render").click()
        page.locator("#problem", has_text="name: expected letters").wait_for()
        assert [text for text in made.errors if not text.startswith("400 ")] == []
        assert all(address.startswith(f"http://127.0.0.1:{server.server_port}/") for address in made.requests)
    server.shutdown()
    server.server_close()
    assert (tmp_path / "mine_rgb.bsdf").exists()
