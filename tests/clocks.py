"""A clock that goes on by the same time whenever it is looked at."""


class SteadyClock:
    """Stands for the module `time`: each look is one step after the last."""

    def __init__(self, step_s: float) -> None:
        self.step_s, self.now_s = step_s, 100.0

    def perf_counter(self) -> float:
        self.now_s += self.step_s
        return self.now_s

    process_time = monotonic = perf_counter
