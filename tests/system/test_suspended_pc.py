"""A PC that is suspended in the middle of a move, as its processes see it: CLOCK_BOOTTIME, the wall clock and the
kernel's receive stamps go on by a night, CLOCK_MONOTONIC does not. The PLC and the camera are other computers."""

import mmap
import shutil
import struct
import subprocess
import sys
from pathlib import Path

import httpx
import pytest

from longreach.fleet_client import JobClient
from longreach.processes import Stack, StackPorts
from protocol.codes import PlcState
from recording.clock import SUSPENDED_REASON

sys.path.insert(0, str(Path(__file__).parent))
from kill_client import Relay

GCC = shutil.which("gcc")
pytestmark = [
    pytest.mark.system,
    pytest.mark.real_time,
    pytest.mark.timeout(400),
    pytest.mark.skipif(GCC is None or sys.platform != "linux", reason="needs gcc on Linux"),
]
NIGHT_NS = 14 * 3600 * 10**9
SHIM = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>
static volatile long long *slept_ns;
__attribute__((constructor)) static void begin(void) {
    slept_ns = mmap(0, sizeof *slept_ns, PROT_READ, MAP_SHARED, open(getenv("SLEPT_FILE"), O_RDONLY), 0);
}
static void later(struct timespec *t) {
    long long ns = *slept_ns + t->tv_nsec;
    t->tv_sec += ns / 1000000000; t->tv_nsec = ns % 1000000000;
}
int clock_gettime(clockid_t which, struct timespec *t) {
    int wrong = (int)syscall(SYS_clock_gettime, which, t);
    if (!wrong && (which == CLOCK_BOOTTIME || which == CLOCK_REALTIME)) later(t);
    return wrong;
}
ssize_t recvmsg(int fd, struct msghdr *message, int flags) {
    ssize_t (*next)(int, struct msghdr *, int) = dlsym(RTLD_NEXT, "recvmsg");
    ssize_t size = next(fd, message, flags);
    if (size < 0) return size;
    for (struct cmsghdr *one = CMSG_FIRSTHDR(message); one; one = CMSG_NXTHDR(message, one))
        if (one->cmsg_level == SOL_SOCKET && one->cmsg_type == SO_TIMESTAMPNS) later((struct timespec *)CMSG_DATA(one));
    return size;
}
"""


class Bed:
    """Where the server's computer sleeps."""

    def __init__(self, folder: Path) -> None:
        self.file, self.library = folder / "slept", folder / "bed.so"
        self.file.write_bytes(struct.pack("<q", 0))
        source = folder / "bed.c"
        source.write_text(SHIM, encoding="utf-8")
        subprocess.run([str(GCC), "-shared", "-fPIC", "-o", self.library, source, "-ldl"], check=True, timeout=60)

    def sleep(self) -> None:
        """Every process under the library has slept a night, between two of its instructions."""
        with self.file.open("r+b") as opened, mmap.mmap(opened.fileno(), 8) as shared:
            shared[:8] = struct.pack("<q", NIGHT_NS)


@pytest.fixture(scope="module")
def stand(tmp_path_factory):
    folder = tmp_path_factory.mktemp("suspended")
    bed = Bed(folder)
    sim = Stack(StackPorts.free(), seed=1, camera_rate_hz=2.0, log_folder=folder / "sim")
    sim.start_sim()
    relay = Relay(sim.ports.plc)
    relay.start()
    free = StackPorts.free()
    ports = StackPorts(http=free.http, plc=relay.port, plc_local=free.plc_local, camera=sim.ports.camera)
    server = Stack(ports, runs_folder=folder / "runs", log_folder=folder / "server")
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("LD_PRELOAD", str(bed.library))
        environment.setenv("SLEPT_FILE", str(bed.file))
        server.start_server()
    try:
        with JobClient(server.url) as client:
            client.wait_ready(300.0)
        yield bed, server, relay
    finally:
        server.close()
        relay.close()
        sim.close()


def retract(http: httpx.Client, held: dict[str, str]) -> httpx.Response:
    return http.post("/v1/jobs", json={"kind": "retract", "distance_mm": 300.0}, headers=held)


def control(http: httpx.Client) -> dict[str, str]:
    lease = http.post("/v1/lease", json={"owner": "night", "ttl_s": 60.0}).json()
    return {"Longreach-Lease": lease["lease_id"], "Longreach-Fencing": str(lease["fencing"])}


def test_a_night_ends_the_move_the_lease_the_look_and_the_arming_and_a_new_job_works(stand):
    bed, server, relay = stand
    with httpx.Client(base_url=server.url, timeout=30.0) as http:
        held = control(http)
        look = http.post("/v1/jobs", json={"kind": "look"}, headers=held).headers["location"]
        while http.get(look).json()["state"] == "running":
            pass
        assert http.get("/v1/state").json()["look"] is not None
        job = retract(http, held).headers["location"]
        relay.wait(lambda state: state.plc_state is PlcState.RUN and state.t_play_ns > 5e8, 20.0, "the retract")
        bed.sleep()
        refused = retract(http, held)
        assert (refused.status_code, refused.json()["code"]) in ((409, "lease_lost"), (409, "lease_stale"))
        relay.wait(lambda state: state.plc_state is not PlcState.RUN, 0.5, "the ramp")
        relay.wait(lambda state: state.plc_state is PlcState.DISARMED, 3.0, "the end of the session")
        while (ended := http.get(job).json())["state"] in ("running", "stopping"):
            pass
        assert (ended["state"], ended["reason"]) == ("stopped", SUSPENDED_REASON)
        assert http.get("/v1/state").json()["look"] is None
        with JobClient(server.url) as client:
            client.wait_ready(120.0)
            assert client.run({"kind": "retract", "distance_mm": 20.0}).state == "done"
