"""The workflow with all files of captures and results in object storage, of a local S3 server.

Nothing of the project's folder is shared but code and settings: what a job reads is fetched from the bucket, and what
it makes is stored there. It takes two minutes: `make storage-test` runs it, `make test` leaves it out.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from importlib.util import find_spec

import pytest

TARGET, BUCKET = "results/tiny/metrics.csv", "avatars"
PACKAGES = ("snakemake_storage_plugin_s3", "moto")

STORAGE = (
    "--default-storage-provider", "s3", "--default-storage-prefix", f"s3://{BUCKET}",
    "--shared-fs-usage", "sources", "source-cache", "software-deployment", "persistence",
)  # fmt: skip
"""Options of Snakemake by which files lie in a bucket, and machines share neither them nor their local copies."""

pytestmark = [pytest.mark.storage, pytest.mark.usefixtures("asked_for"), pytest.mark.timeout(3600)]


@pytest.fixture(scope="module")
def asked_for(request):
    """Skips what was not asked for, and what cannot run here."""
    if "storage" not in request.config.getoption("markexpr"):
        pytest.skip("takes minutes: make storage-test")
    if absent := [name for name in PACKAGES if find_spec(name) is None]:
        pytest.skip(f"no {', '.join(absent)} of moto and Snakemake's plugin: pip install --editable '.[storage]'")


@pytest.fixture(scope="module")
def bucket():
    """The variables of the environment that lead to an empty bucket, and a client of it."""
    import boto3
    from moto.server import ThreadedMotoServer

    server = ThreadedMotoServer("127.0.0.1", 0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    endpoint, secret = f"http://{host}:{port}", "none"
    client = boto3.client(
        "s3", endpoint_url=endpoint, region_name="us-east-1", aws_access_key_id=secret, aws_secret_access_key=secret
    )
    client.create_bucket(Bucket=BUCKET)
    named = {"ENDPOINT_URL": endpoint, "ACCESS_KEY": secret, "SECRET_KEY": secret}
    yield {f"SNAKEMAKE_STORAGE_S3_{name}": value for name, value in named.items()}, client
    server.stop()


@pytest.fixture(scope="module")
def stored(copy_of_project, bucket, tmp_path_factory):
    """A project after a run from nothing, in chunks whose images are shared, that left its files in the bucket."""
    workflow = copy_of_project(tmp_path_factory.mktemp("stored") / "project")
    workflow.append("config/subjects/tiny.yaml", "chunk_frames: 2\nchunk_images: 12\n")
    printed = run(workflow, bucket[0])
    assert "inspect_images" in printed and "score_images" in printed
    return workflow


def run(workflow, variables, *words):
    """What Snakemake prints of a run, which has to succeed."""
    environment = {**os.environ, **variables, "PYTHONPATH": str(workflow.folder)}
    command = [sys.executable, "-m", "snakemake", "--cores", "2", *STORAGE, *words, "--", TARGET]
    done = subprocess.run(command, cwd=workflow.folder, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


def test_object_storage_gives_the_bytes_of_one_file_system(stored, bucket, copy_of_project, stage_server, tmp_path):
    local = copy_of_project(tmp_path / "project").with_stages_of(stage_server)
    done = local.snakemake("--", TARGET)
    assert done.returncode == 0, done.stdout
    content = bucket[1].get_object(Bucket=BUCKET, Key=TARGET)["Body"].read()
    assert content == (local.folder / TARGET).read_bytes()


def test_nothing_lies_in_the_projects_folder(stored):
    assert not {"captures", "results"} & {path.name for path in stored.folder.iterdir()}


def test_finished_run_has_nothing_to_do(stored, bucket):
    assert "Nothing to be done" in run(stored, bucket[0])


def test_another_machine_goes_on_from_the_bucket(stored, bucket, copy_of_project, tmp_path):
    """One with the same code and settings and what Snakemake knows of the run, and none of its files."""
    elsewhere = stored.copied(tmp_path / "project")
    for folder in (elsewhere.folder / ".snakemake").iterdir():
        if folder.name != "metadata":
            subprocess.run(["rm", "-r", str(folder)], check=True)
    words = ("--forcerun", "evaluate_avatar")
    assert re.findall(r"^Finished jobid: \d+ \(Rule: (\w+)\)", run(elsewhere, bucket[0], *words), re.MULTILINE) == [
        "evaluate_avatar"
    ]
    assert "Nothing to be done" in run(elsewhere, bucket[0])


def test_captures_outside_the_project_are_refused(copy_of_project, bucket, tmp_path):
    workflow = copy_of_project(tmp_path / "project")
    environment = {**os.environ, **bucket[0], "PYTHONPATH": str(workflow.folder)}
    words = ("--cores", "2", "--dry-run", *STORAGE, "--config", "captures=/data/captures", "--", TARGET)
    done = subprocess.run(
        [sys.executable, "-m", "snakemake", *words],
        cwd=workflow.folder,
        env=environment,
        capture_output=True,
        text=True,
    )
    assert done.returncode != 0
    assert "captures: expected a folder of the project" in done.stdout + done.stderr
