"""`legid completion`: the shell completes commands, options, names and files."""

from __future__ import annotations

import argparse

SHELLS = ("bash", "zsh", "fish")
HOW = {"bash": 'eval "$(legid completion bash)" in ~/.bashrc',
       "zsh": 'eval "$(legid completion zsh)" in ~/.zshrc, after compinit',
       "fish": "legid completion fish > ~/.config/fish/completions/legid.fish"}


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "completion", help="print what a shell needs to complete legid's commands and options",
        description="Print the script by which a shell completes commands, options, the names that they take, and "
                    "files: " + "; ".join(HOW.values()) + ".")
    parser.add_argument("shell", choices=SHELLS, help="which shell")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print the script."""
    from argcomplete.shell_integration import shellcode

    print(shellcode(["legid"], shell=args.shell))
    return 0
