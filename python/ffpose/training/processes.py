"""Several processes that train one network together, each on its share of every epoch.

They come from ``torchrun`` (on any number of machines, so that Slurm, Kubernetes or Ray Train can
launch it), which describes the group in the environment, or from ``ffpose train --processes N`` on
this machine. `torch.nn.parallel.DistributedDataParallel` averages their gradients in the backward
pass, over gloo on CPUs and NCCL on GPUs. Process 0 writes the files.
"""

from __future__ import annotations

import multiprocessing
import os
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field
from datetime import timedelta
from multiprocessing.process import BaseProcess
from typing import Any, TypeVar

import torch
from torch import Tensor, distributed, nn
from torch.distributed import ProcessGroup, TCPStore  # type: ignore[attr-defined]  # undeclared
from torch.distributed.distributed_c10d import PrefixStore, Store
from torch.distributed.rendezvous import rendezvous
from torch.nn.parallel import DistributedDataParallel

from ffpose._internal.machine import environment
from ffpose._internal.signals import (
    exit_on_sigterm,
    interrupts_held,
    leave_interrupts_to_parent,
)
from ffpose.errors import expect

BACKENDS = "cpu:gloo,cuda:nccl"
"""Backends of processes with a GPU: gradients are on it, sums and metrics on the CPU."""

LONGEST_WAIT = timedelta(days=7)
"""For what one process does alone, such as rendering; where one dies, its connections close."""

JOINED = "joined"
HERE = "127.0.0.1"

T = TypeVar("T")

_beside: list[tuple[TCPStore, list[BaseProcess]]] = []
"""What `started` has started beside this process, which waits until all have come to the store."""


@dataclass(frozen=True)
class Processes:
    """This process's rank among those that train together, and how many of them are here.

    ``patient`` is the group of what is on the CPU, which waits for as long as it takes.
    """

    rank: int = 0
    world: int = 1
    here: int = 1
    patient: ProcessGroup | None = field(default=None, compare=False, repr=False)

    @property
    def leads(self) -> bool:
        """Whether this is the process that writes the files."""
        return self.rank == 0

    def share(self, count: int) -> range:
        """Return this process's samples out of ``count``, in turns."""
        return range(self.rank, count, self.world)

    def workers(self, count: int) -> int:
        """Return how many of this machine's workers each of its processes has, rounded up."""
        return -(-count // self.here)

    def wait(self) -> None:
        """Wait until every process is here."""
        if self.world > 1:
            distributed.barrier(self.patient)

    def same(self, what: T) -> T:
        """Return what process 0 gives, which can be pickled; the others wait for it."""
        box = [what]
        if self.world > 1:
            distributed.broadcast_object_list(box, 0, group=self.patient)
        return box[0]

    def total(self, values: Tensor) -> Tensor:
        """Return the sum of all processes' values, which are on the CPU."""
        if self.world > 1:  # a group that another program has joined may be of GPUs alone
            distributed.all_reduce(values, group=self.patient)
        return values

    def parallel(self, objective: nn.Module) -> nn.Module:
        """Return a module of one result and of gradients that are the mean of all processes'.

        All that is trained is in it and gets a gradient; what is frozen must be so already.
        """
        if self.world == 1:
            return objective
        # A batch of one image gives the class token a gradient of other strides, which is copied.
        warnings.filterwarnings("ignore", "Grad strides do not match bucket view strides")
        return DistributedDataParallel(objective)

    @torch.no_grad()
    def agree(self, module: nn.Module) -> None:
        """Give every process the buffers of process 0, such as batch norm's running statistics."""
        buffers = [each for each in module.buffers() if each.is_floating_point()]
        if self.world > 1 and buffers:
            flat = torch.cat([buffer.flatten() for buffer in buffers])
            distributed.broadcast(flat, 0)
            pieces = torch.split(flat, [each.numel() for each in buffers])
            for buffer, piece in zip(buffers, pieces, strict=True):
                buffer.copy_(piece.view_as(buffer))

    @contextmanager
    def leader_first(self) -> Iterator[None]:
        """Let process 0 do something before the others, which find what it left in files."""
        if not self.leads:
            self.wait()
        yield
        if self.leads:
            self.wait()


ALONE = Processes()


def launched() -> int:
    """Return the number of processes that ``torchrun`` has started; 1 without it."""
    return int(os.environ.get("WORLD_SIZE", "1"))


def count_processes(asked: int) -> int:
    """Return the number of processes that train: as asked, or those of ``torchrun``.

    Raises:
        ValueError: ``torchrun`` has started processes, and others were asked for.
    """
    world = launched()
    expected = f"1 or {world} under torchrun, which starts them itself"
    expect(world == 1 or asked in (1, world), "processes", expected, asked)
    return asked if world == 1 else world


@contextmanager
def joined(device: str) -> Iterator[Processes]:
    """Join the group of ``torchrun``'s environment, and leave it at the end."""
    world = launched()
    if world == 1 or distributed.is_initialized():
        yield ALONE if world == 1 else current()
        return
    kind, _, number = device.partition(":")
    gpu = kind == "cuda" or (device == "auto" and torch.cuda.is_available())
    if gpu:
        own = _own_gpu()
        expected = f"cuda:{own} or cuda, as each process has a GPU of its own"
        expect(number in ("", str(own)), "device", expected, device)
        torch.cuda.set_device(own)
    distributed.init_process_group(
        BACKENDS if gpu else "gloo", store=_store(), rank=int(os.environ["RANK"]), world_size=world
    )
    try:
        yield current()
    finally:
        distributed.destroy_process_group()


def _own_gpu() -> int:
    """Return the number of this process's GPU: its number on its machine, 0 where none is told."""
    number, count = int(os.environ.get("LOCAL_RANK", "0")), torch.cuda.device_count()
    if number >= count:
        raise ValueError(f"processes: expected at most {count}, one a GPU, got {number + 1}")
    return number


def _store() -> Store:
    """Return the store in which the processes of this start find each other.

    ``torchrun`` keeps one store over its restarts of a group (PyTorch issue 135712): a process that
    is early would find the addresses of those that ended, and wait for them. On one machine the
    starts are counted; on several the counts differ, and docs/training.md names the remedy.
    """
    for own, others in _beside:  # torch would wait for the dead, deaf to signals
        while own.add(JOINED, 0) < len(others):
            for rank, process in enumerate(others, start=1):
                if process.exitcode is not None:
                    raise ChildProcessError(
                        f"process {rank} of {len(others)} beside this one ended with code"
                        f" {process.exitcode} before the training began"
                    )
            time.sleep(0.05)
        return own
    store: Store = next(iter(rendezvous("env://")))[0]
    store.add(JOINED, 1)
    start = os.environ.get("TORCHELASTIC_RESTART_COUNT", "0")
    one_machine = os.environ.get("LOCAL_WORLD_SIZE") == os.environ["WORLD_SIZE"]
    return PrefixStore(start, store) if one_machine else store


def current() -> Processes:
    """Return this process's place in the group that it has joined."""
    world = distributed.get_world_size()
    here = int(os.environ.get("LOCAL_WORLD_SIZE", world))
    patient = distributed.new_group(backend="gloo", timeout=LONGEST_WAIT)
    assert isinstance(patient, ProcessGroup)  # every process is of it
    return Processes(distributed.get_rank(), world, here, patient)


def accumulating(objective: nn.Module, *, last: bool) -> AbstractContextManager[None]:
    """Leave gradients to this process alone until the ``last`` batch of a step."""
    if last or not isinstance(objective, DistributedDataParallel):
        return nullcontext()
    alone: AbstractContextManager[None] = objective.no_sync()
    return alone


@contextmanager
def started(count: int, work: Callable[..., Any], *args: Any) -> Iterator[None]:
    """Start ``count - 1`` processes beside this one, which leads, for as long as the block runs.

    The environment says of each what ``torchrun`` would, whose own are there already, and torch's
    threads are shared out. The others call ``work``, a function of a module, and leave Ctrl-C to
    this one. They end where the block raises, and where SIGTERM ends this process, with code 143.
    """
    if count == 1 or launched() > 1:
        yield
        return
    own = torch.get_num_threads()
    threads = max(1, own // count)
    context = multiprocessing.get_context("spawn")
    others = list[BaseProcess]()
    try:
        with exit_on_sigterm():
            with interrupts_held():
                store = TCPStore(HERE, 0, is_master=True, wait_for_workers=False)
                port = str(store.port)
                place = {"WORLD_SIZE": str(count), "MASTER_ADDR": HERE, "MASTER_PORT": port}
                others += [
                    context.Process(target=_follow, args=(place, rank, threads, work, args))
                    for rank in range(1, count)
                ]
                for process in others:
                    process.start()
            _beside.append((store, others))
            torch.set_num_threads(threads)
            with environment(RANK="0", LOCAL_RANK="0", **place):
                yield
    except BaseException:
        for process in others:
            if process.is_alive():
                process.terminate()
        raise
    finally:
        for process in others:
            if process.pid is not None:
                process.join()
        _beside.clear()
        torch.set_num_threads(own)


def _follow(
    place: dict[str, str], rank: int, threads: int, work: Callable[..., Any], args: tuple[Any, ...]
) -> None:
    leave_interrupts_to_parent()
    os.environ.update(place, RANK=str(rank), LOCAL_RANK=str(rank))
    torch.set_num_threads(threads)
    work(*args)
