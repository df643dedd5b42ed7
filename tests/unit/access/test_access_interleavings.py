"""Two fleets and an operator, retries, lost answers and crashes, interleaved at random in virtual time, over
the lease book, the idempotency rule and a real SQLite file's rows: exactly-once motion, never two owners.

Every step of every client may be cut between any two others; a crash forgets memory and keeps what was committed.
"""

import random
import sqlite3
from dataclasses import dataclass, field

import pytest

from server.access.errors import AccessError
from server.access.lease import Lease, LeaseBook, LeaseKind
from server.jobs.engine import Job, JobState
from server.jobs.keeper import add_job, end_interrupted, end_job, read_jobs
from server.store.audit_rows import read_fencing, save_fencing
from server.store.database import migrate
from server.store.idempotency import StoredAnswer, hash_of, read_answer, replay_of, save_answer

STEPS = 150
TTL_S = 5.0


@dataclass
class World:
    """What a server is made of, without its clock, sockets and threads."""

    rng: random.Random
    now_s: float = 1000.0
    db: sqlite3.Connection = field(default_factory=lambda: sqlite3.connect(":memory:", isolation_level=None))
    book: LeaseBook = field(default_factory=LeaseBook)
    in_progress: set[tuple[str, str]] = field(default_factory=set)
    running: Job | None = None
    life: int = 0
    begun: list[tuple[str, int]] = field(default_factory=list)  # (command, fencing) of every motion that ever began

    def __post_init__(self):
        self.db.row_factory = sqlite3.Row
        migrate(self.db, 0)

    def crash(self):
        """Memory is gone; what was committed is read again, as the server's start does."""
        self.life += 1
        self.running, self.in_progress = None, set()
        end_interrupted(self.db)
        self.book = LeaseBook(read_fencing(self.db))

    def enforce(self):
        """The lease guard."""
        job = self.running
        if job is not None and self.book.why_lost(job.fencing, self.now_s):
            self.end(JobState.STOPPED)

    def end(self, state):
        job, self.running = self.running, None
        job.state = state
        end_job(self.db, job, None)


class Client:
    """One program or person that wants commands carried out once each, and repeats them until it knows an answer."""

    def __init__(self, world, name, kind):
        self.world, self.name, self.kind = world, name, kind
        self.lease: Lease | None = None
        self.number = 0
        self.answers: dict[str, set[str]] = {}

    def wish(self):
        """Do something; yields wherever others may come in between."""
        rng = self.world.rng
        if self.lease is None or rng.random() < 0.15:
            yield from self.get_control()
        if rng.random() < 0.1 and self.lease is not None:
            self.try_to(self.world.book.release, self.lease.lease_id, self.world.now_s)
        if rng.random() < 0.7:
            self.number += 1
        for _ in range(rng.choice((1, 1, 2, 3))):  # retries: the answer was lost
            yield from self.send(f"{self.name} {self.number}")

    def try_to(self, action, *args):
        try:
            return action(*args)
        except AccessError:
            return None

    def get_control(self):
        world, secret = self.world, f"{self.name} {self.world.rng.random()}"
        if self.kind is LeaseKind.OPERATOR and world.rng.random() < 0.5:
            lease = self.try_to(world.book.take_control, self.name, self.kind, TTL_S, "drill", secret, world.now_s)
        else:
            lease = self.try_to(world.book.acquire, self.name, self.kind, TTL_S, secret, world.now_s)
        life = world.life
        yield
        if lease is None or life != world.life:  # the connection broke with the server
            return
        save_fencing(world.db, lease.fencing)
        yield
        if life == world.life:
            self.lease = lease

    def send(self, command):
        """As JobCommands and JobEngine.submit_kept do it, cut at each await."""
        world, life, mark, lease = self.world, self.world.life, (self.name, command), self.lease
        if lease is None:
            return
        mine = mark not in world.in_progress
        world.in_progress.add(mark)
        yield
        if life != world.life:
            return
        try:
            known = replay_of(read_answer(world.db, *mark), not mine, hash_of(command.encode()))
            if known is not None:
                self.answers.setdefault(command, set()).add(known.response_body)
                return
            held = world.book.check(lease.lease_id, lease.fencing, world.now_s)
            if world.running is not None:
                return
            job = Job(f"{command} {world.rng.random()}", "park", self.name, fencing=held.fencing)
            world.running = job
            yield from self.carry_out(command, job, life)
        except AccessError:
            return
        finally:
            if mine and life == world.life:
                world.in_progress.discard(mark)

    def carry_out(self, command, job, life):
        world = self.world
        yield  # the writer's queue
        if life != world.life:
            return
        world.db.execute("BEGIN IMMEDIATE")
        add_job(world.db, job, "{}")
        save_fencing(world.db, job.fencing)
        save_answer(world.db, self.name, command, StoredAnswer(hash_of(command.encode()), 202, "", job.job_id))
        if world.rng.random() < 0.05:  # the power fails before the commit
            world.db.execute("ROLLBACK")
            return world.crash()
        world.db.execute("COMMIT")
        yield  # back in the event loop
        if life != world.life or world.running is not job:  # stopped while it was written down
            return
        if world.book.why_lost(job.fencing, world.now_s):
            return world.end(JobState.STOPPED)
        world.begun.append((command, job.fencing))
        if world.rng.random() < 0.7:
            self.answers.setdefault(command, set()).add(job.job_id)
        for _ in range(world.rng.randrange(4)):
            yield
            if life != world.life or world.running is not job:
                return
        world.end(JobState.DONE)


def interleaved(seed):
    world = World(random.Random(seed))
    clients = [
        Client(world, "fleet 1", LeaseKind.FLEET),
        Client(world, "fleet 2", LeaseKind.FLEET),
        Client(world, "anna", LeaseKind.OPERATOR),
    ]
    doing = []
    for _ in range(STEPS):
        world.now_s += world.rng.choice((0.01, 0.1, 0.5))
        world.enforce()
        event = world.rng.random()
        if event < 0.03:
            world.crash()
        elif event < 0.3 or not doing:
            doing.append(world.rng.choice(clients).wish())
        for client in clients:
            if client.lease is not None and world.rng.random() < 0.4:
                client.try_to(world.book.keep_alive, client.lease.lease_id, world.now_s)
        wish = world.rng.choice(doing) if doing else iter(())
        if next(wish, "over") == "over" and wish in doing:
            doing.remove(wish)
        fencings = {client.lease.fencing for client in clients if client.lease and valid(world, client.lease)}
        assert len(fencings) <= 1, f"seed {seed}: two owners"
        if world.running is not None:
            assert world.running.fencing <= world.book.fencing
    return world, clients


def valid(world, lease):
    try:
        world.book.check(lease.lease_id, lease.fencing, world.now_s)
    except AccessError:
        return False
    return True


@pytest.mark.parametrize("block", range(10))
def test_motion_is_exactly_once_and_control_is_never_two_peoples(block):
    begun = crashes = replays = 0
    for seed in range(100 * block, 100 * block + 100):
        world, clients = interleaved(seed)
        commands = [command for command, _ in world.begun]
        assert len(commands) == len(set(commands)), f"seed {seed}: a command moved twice"
        for client in clients:
            for command, answers in client.answers.items():
                assert len(answers) == 1, f"seed {seed}: {command} was answered in two ways"
        numbers = [fencing for _, fencing in world.begun]
        assert numbers == sorted(numbers), f"seed {seed}: an older holder moved after a newer one"
        world.crash()
        assert all(job.has_ended for job in read_jobs(world.db)), f"seed {seed}: a job without an end"
        world.db.close()
        begun, crashes = begun + len(commands), crashes + world.life
        replays += sum(len(client.answers) for client in clients)
    print(f"{begun} motions, {crashes} crashes, {replays} answers known")
    assert begun > 150  # the drill does move, crash and answer
    assert crashes > 100
    assert replays > 100
