"""`legid completion`: the shell completes commands, options, names and files."""

from __future__ import annotations

import argparse

from experiments.cli.command import Command, argument

HOW = {"bash": 'eval "$(legid completion bash)" in ~/.bashrc',
       "zsh": 'eval "$(legid completion zsh)" in ~/.zshrc, after compinit',
       "fish": "legid completion fish > ~/.config/fish/completions/legid.fish"}
COMMAND = Command(
    "completion", "print what a shell needs to complete legid's commands and options",
    "Print the script by which a shell completes commands, options, the names that they take, and files: "
    + "; ".join(HOW.values()) + ".", (argument("shell", choices=tuple(HOW), help="which shell"),))


def run(args: argparse.Namespace) -> int:
    """Print the script."""
    from argcomplete.shell_integration import shellcode

    print(shellcode(["legid"], shell=args.shell))
    return 0
