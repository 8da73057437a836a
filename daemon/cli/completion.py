"""Completion scripts for bash and zsh, made of the commands' own parsers."""

import argparse
import importlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

_SCRIPT = """\
# steerd completion for bash and zsh; made by `steerd completion {shell}`.
{zsh}_steerd() {{
  local cur=${{COMP_WORDS[COMP_CWORD]}} prev=${{COMP_WORDS[COMP_CWORD-1]}} cmd=${{COMP_WORDS[1]}}
  COMPREPLY=()
  if [ "$COMP_CWORD" -eq 1 ]; then
    COMPREPLY=($(compgen -W "{commands} --help --version" -- "$cur")); return
  fi
  case "$cmd:$prev" in
{choices}  esac
  case "$cur" in
    -*) case "$cmd" in
{options}    esac ;;
    *) case "$cmd" in
{words}    esac
      COMPREPLY+=($(compgen -f -- "$cur")) ;;
  esac
}}
complete -o filenames -F _steerd steerd
"""


@dataclass(frozen=True)
class Spoken:
    """What a command understands: options, words in fixed places, values of options."""

    options: tuple[str, ...]
    words: tuple[str, ...]
    values: Mapping[str, tuple[str, ...]]


def read_parser(parser: argparse.ArgumentParser) -> Spoken:
    """All that a parser and its sub-parsers understand."""
    options: list[str] = []
    words: list[str] = []
    values: dict[str, tuple[str, ...]] = {}
    for action in parser._actions:  # noqa: SLF001 (argparse has no public list)
        options += action.option_strings
        if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001
            words += action.choices
            for child in action.choices.values():
                inner = read_parser(child)
                options += inner.options
                words += inner.words
                values |= inner.values
        elif action.choices is not None:
            named = tuple(map(str, action.choices))
            values |= dict.fromkeys(action.option_strings, named)
            words += () if action.option_strings else named
    return Spoken(tuple(dict.fromkeys(options)), tuple(dict.fromkeys(words)), values)


def read_commands(modules: Mapping[str, str]) -> Iterator[tuple[str, Spoken]]:
    """Every command and what it understands.

    Args:
        modules: module below `steerd.daemon.cli.commands` by command.
    """
    for name, module in modules.items():
        parser = argparse.ArgumentParser(prog=f"steerd {name}")
        importlib.import_module(f"steerd.daemon.cli.commands.{module}").add_arguments(parser)
        yield name, read_parser(parser)


def make_script(shell: str, commands: Sequence[tuple[str, Spoken]]) -> str:
    """The script for a shell, `bash` or `zsh`."""
    reply = 'COMPREPLY=($(compgen -W "{}" -- "$cur"))'
    choices = "".join(
        f"    {name}:{option}) {reply.format(' '.join(values))}; return ;;\n"
        for name, spoken in commands
        for option, values in spoken.values.items()
    )
    options = "".join(
        f"      {name}) {reply.format(' '.join(spoken.options))} ;;\n" for name, spoken in commands
    )
    words = "".join(
        f"      {name}) {reply.format(' '.join(spoken.words))} ;;\n"
        for name, spoken in commands
        if spoken.words
    )
    return _SCRIPT.format(
        shell=shell,
        zsh="autoload -Uz bashcompinit && bashcompinit\n" if shell == "zsh" else "",
        commands=" ".join(name for name, _ in commands),
        choices=choices,
        options=options,
        words=words,
    )
