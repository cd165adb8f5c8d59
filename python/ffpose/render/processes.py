"""Rendering in this process or in several, which changes no byte: images are pure functions."""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from multiprocessing.connection import wait
from typing import Any, TypeVar

from ffpose._internal.locks import fork_safe_lock
from ffpose._internal.machine import environment, worker_processes
from ffpose._internal.signals import interrupts_held, leave_interrupts_to_parent

Item = TypeVar("Item")
Result = TypeVar("Result")

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Environment of workers: more threads than one each would only contend."""

AHEAD = 4
"""Results per process that are under way or wait to be taken: there may be gigabytes of them."""


def in_processes(
    task: Callable[[Item], Result], items: Sequence[Item], workers: int, method: str = "spawn"
) -> Iterator[Result]:
    """Yield what a task makes of each item, in order; few items are done in the calling process.

    Workers run on one thread each, end with their parent, and leave Ctrl-C to it: then every one
    finishes its item. The task is sent to each once, because a spacecraft may be a large mesh; with
    the ``method`` of starting "fork" they share what the parent has prepared.
    """
    if workers <= 1 or len(items) < 2 * workers:
        yield from map(task, items)
        return
    count, context = worker_processes(workers, len(items)), multiprocessing.get_context(method)
    with ProcessPoolExecutor(count, context, _start, (task,)) as pool:

        def submit(item: Item) -> Future[Result]:
            with _starting, environment(**ONE_THREAD), interrupts_held():  # it starts workers
                return pool.submit(_run, item)

        try:
            yield from ahead(submit, items, AHEAD * count)
        finally:
            pool.shutdown(cancel_futures=True)


def ahead(
    submit: Callable[[Item], Future[Result]], items: Iterable[Item], most: int
) -> Iterator[Result]:
    """Yield results in order, with at most ``most`` under way or waiting."""
    waiting: deque[Future[Result]] = deque()
    for item in items:
        waiting.append(submit(item))
        if len(waiting) >= most:
            yield waiting.popleft().result()
    while waiting:
        yield waiting.popleft().result()


_starting = fork_safe_lock()
"""Lock of a thread that starts workers, as the environment is one for all threads."""

_task: list[Callable[[Any], Any]] = []
"""Task of this worker process."""

_busy = threading.Lock()
"""Lock that this worker process holds while it renders and writes."""


def _start(task: Callable[[Any], Any]) -> None:
    _task[:] = [task]
    leave_interrupts_to_parent()
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """Exit this worker between two items once its parent has exited for any reason."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        with _busy:
            os._exit(1)


def _run(item: Any) -> Any:
    with _busy:
        return _task[0](item)
