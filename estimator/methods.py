"""The methods that a fit can be made by; beside the options, for whoever lists them need not load any."""

from __future__ import annotations

from typing import Literal, get_args

Method = Literal["mle", "wls", "rls", "hekf"]
METHODS: tuple[Method, ...] = get_args(Method)
ResultMethod = Literal[Method, "mle-free", "shooting"]
"""As a result names it: `mle-free` is `mle` with `FitOptions.latent` free; `shooting` is reported in place of `mle`
where held-out data favours it."""
