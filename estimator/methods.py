"""Names of the methods of a fit; a separate module, so that listing them loads no method."""

from __future__ import annotations

from typing import Literal, get_args

Method = Literal["mle", "wls", "rls", "hekf"]
METHODS: tuple[Method, ...] = get_args(Method)
ResultMethod = Literal[Method, "mle-free", "shooting"]
"""As a result names it: `mle-free` is `mle` with `FitOptions.latent` free; `shooting` is reported in place of `mle`
where held-out data favours it."""
