"""The journal of jobs: what a killed server leaves behind is told by the next one."""

from server.jobs.engine import Job, JobEvent, JobState
from server.jobs.journal import JobJournal

STARTED = JobEvent(1, 0.0, "started", 0.0, 1.0, "", "")
ENDED = JobEvent(2, 1.0, "ended", 1.0, 1.0, "", "")
PROGRESS = JobEvent(3, 0.5, "look", 0.0, 1.0, "", "")


def test_a_job_without_an_end_was_interrupted(tmp_path):
    journal = JobJournal(tmp_path / "runs" / "jobs.jsonl")
    done, killed = Job("a1", "look", "anna"), Job("b2", "position", "fleet")
    journal.note(done, STARTED)
    done.state, done.ended_mono_s = JobState.DONE, done.started_mono_s + 2.0
    journal.note(done, ENDED)
    journal.note(killed, STARTED)
    journal.note(killed, PROGRESS)

    first, second = journal.restore()
    assert (first.job_id, first.state, first.kind, first.owner) == ("a1", JobState.DONE, "look", "anna")
    assert abs(first.elapsed_s - 2.0) < 1e-6
    assert (second.job_id, second.state, second.code) == ("b2", JobState.INTERRUPTED, "interrupted")
    assert "watchdog" in second.reason
    assert second.ended
    again = journal.restore()
    assert [job.state for job in again] == [JobState.DONE, JobState.INTERRUPTED]


def test_damaged_lines_are_passed_over_and_only_the_last_200_are_kept(tmp_path):
    path = tmp_path / "jobs.jsonl"
    journal = JobJournal(path)
    for i in range(250):
        journal.note(Job(f"j{i}", "look", "x"), STARTED)
    with path.open("a", encoding="utf-8") as file:
        file.write('{"job_id": "cut off by the ki\nnull\n[]\n{"job_id": 3}\n')
    restored = journal.restore()
    assert [job.job_id for job in restored] == [f"j{i}" for i in range(50, 250)]
    assert len(path.read_text().splitlines()) == 200


def test_nothing_is_kept_without_a_file_and_a_full_disk_is_only_logged(tmp_path, caplog):
    JobJournal(None).note(Job("a", "look", "x"), STARTED)
    assert JobJournal(None).restore() == []
    blocked = tmp_path / "file"
    blocked.write_text("")
    JobJournal(blocked / "jobs.jsonl").note(Job("a", "look", "x"), STARTED)
    assert "jobs are not kept" in caplog.text
