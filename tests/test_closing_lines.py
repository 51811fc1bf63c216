"""What the end of a run says of tests that were left out, how tests run with several threads, and how long they take."""

import json
from pathlib import Path

import pytest

from tests.deep import deep
from tests.slowest import table

CONFTEST = Path(__file__).with_name("conftest.py").read_text().replace('pytest_plugins = ["pytester"]', "")
INI = """[pytest]
markers = deep
"""


@pytest.fixture
def run(pytester, monkeypatch):
    """Runs pytest on the text of a test module, with this folder's conftest; the result."""
    def run_tests(text: str, *arguments: str) -> pytest.RunResult:
        pytester.makeconftest(CONFTEST)
        pytester.makeini(INI)
        pytester.makepyfile(text)
        monkeypatch.setitem(__import__("sys").modules, "mitsuba", None)  # as if it were not installed
        return pytester.runpytest("-p", "no:cacheprovider", *arguments)

    return run_tests


def test_skipped_comparisons_with_mitsuba_are_counted_above_the_closing_line(run):
    result = run("""
        import pytest
        def test_ours(): pass
        def test_theirs(mi): assert False
        @pytest.mark.parametrize("name", "ab")
        def test_theirs_too(name): pytest.importorskip("mitsuba")
        def test_skipped_for_another_reason(): pytest.skip("no such machine")
    """)
    assert result.outlines[-3] == "3 comparisons with Mitsuba skipped: install the extra `peer`, or run `make test-peer`"
    result.assert_outcomes(passed=1, skipped=4)


def test_deep_tests_run_when_asked_for_and_alone(run):
    text = """
        import pytest
        def test_quick(): pass
        @pytest.mark.deep
        def test_deep(): pass
    """
    result = run(text)
    assert result.outlines[-2] == "deep tests are left out: run `make test-deep`"
    result.assert_outcomes(passed=1, deselected=1)
    result = run(text, "--deep")
    assert "left out" not in result.stdout.str()
    result.assert_outcomes(passed=1, deselected=1)


def test_nothing_left_out_is_nothing_said(run):
    result = run("import pytest\n@pytest.mark.deep\ndef test_ours(): pass", "--deep")
    result.assert_outcomes(passed=1)
    assert "left out" not in result.stdout.str() and "Mitsuba" not in result.stdout.str()


def test_tests_that_use_threads_run_with_one_thread_and_with_two(run):
    result = run("""
        import pytest, torch
        NUMBERS = []
        def test_before(): NUMBERS.append(torch.get_num_threads())
        @pytest.mark.usefixtures("threads")
        def test_marked(): NUMBERS.append(torch.get_num_threads())
        def test_after(): assert NUMBERS[1:] == [1, 2] and torch.get_num_threads() == NUMBERS[0]
    """)
    result.assert_outcomes(passed=4)


@pytest.mark.parametrize("workers", ["0", "1", deep("2")])
def test_durations_of_all_tests_are_kept_the_longest_first(run, pytester, workers):
    pytest.importorskip("xdist")
    run("""
        import time, pytest
        def test_short(): pass
        @pytest.mark.parametrize("name", "ab")
        def test_long(name): time.sleep(0.05)
        def test_skipped(): pytest.skip("not now")
    """, "-n", workers, "--keep-durations", "kept/durations.json")
    seconds = json.loads((pytester.path / "kept" / "durations.json").read_text())
    file = next(iter(seconds)).partition("::")[0]
    assert {name.partition("::")[2] for name in list(seconds)[:2]} == {"test_long[a]", "test_long[b]"}
    assert set(list(seconds)[2:]) == {f"{file}::test_short", f"{file}::test_skipped"}
    assert 0.1 <= sum(seconds.values()) < 5


def test_the_slowest_tests_and_files_are_printed():
    printed = table({"a.py::test_one": 1.0, "b.py::test_two[x]": 2.0, "a.py::test_three": 1.5, "b.py::test_four": 0.0}, 2)
    assert printed.splitlines() == [
        "4 s in 4 tests of 2 files", "", "    2.00 s  44.4 %  b.py::test_two[x]", "    1.50 s  33.3 %  a.py::test_three", "",
        "    2.50 s  55.6 %  a.py", "    2.00 s  44.4 %  b.py"]


def test_the_file_of_durations_is_joined_to_its_option():
    """Else pytest takes it for a test file as soon as it exists, and a second `make test` fails."""
    makefile = (Path(__file__).parents[1] / "Makefile").read_text()
    assert "--keep-durations=" in makefile and "--keep-durations " not in makefile
