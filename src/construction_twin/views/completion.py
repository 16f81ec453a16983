"""Completion of a command line for bash, made from its argparse parser: commands, options, choices. Standard library only."""

from __future__ import annotations

import argparse

_SCRIPT = """\
# bash completion of `rosrun construction_twin twin`, and of `twin`, a short name for it. Load it in a shell:
#   source <(rosrun construction_twin twin --completion bash)
twin() {{ rosrun construction_twin twin "$@"; }}
_twin_words() {{
  case "$1" in
{cases}
  esac
}}
_twin_complete() {{
  local first=$1 command="" word=${{COMP_WORDS[COMP_CWORD]}} previous=${{COMP_WORDS[COMP_CWORD-1]}} index
  for ((index = first + 1; index < COMP_CWORD; index++)); do
    case " {commands} " in *" ${{COMP_WORDS[index]}} "*) command=${{COMP_WORDS[index]}}; break ;; esac
  done
  case "$previous" in
{values}
  esac
  COMPREPLY=($(compgen -W "$(_twin_words "$command")" -- "$word"))
}}
_twin_alone() {{ COMPREPLY=(); _twin_complete 0; }}
_twin_rosrun() {{
  COMPREPLY=()
  if [[ ${{COMP_WORDS[1]-}} == construction_twin && ${{COMP_WORDS[2]-}} == twin && $COMP_CWORD -gt 2 ]]; then
    _twin_complete 2
  elif declare -F _roscomplete_exe > /dev/null; then
    _roscomplete_exe "$@"
  fi
}}
complete -F _twin_alone twin
complete -F _twin_rosrun rosrun
"""


def bash_completion(parser: argparse.ArgumentParser) -> str:
    """Return the script.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        With at most one level of commands.

    Returns
    -------
    script : str
        Defines the shell function `twin`, and completes it and ``rosrun construction_twin twin``; every other `rosrun` is
        left to ROS's own completion.
    """
    commands = _commands(parser)
    words = {"": [*_options(parser), *commands]} | {name: _options(sub) for name, sub in commands.items()}
    cases = "\n".join(f'    "{name}") echo "{" ".join(options)}" ;;' for name, options in words.items())
    values = "\n".join(sorted(set().union(*(_values(each) for each in (parser, *commands.values())))))
    return _SCRIPT.format(cases=cases, commands=" ".join(commands), values=values)


def _commands(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    found = [action.choices for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    return dict(found[0]) if found else {}


def _options(parser: argparse.ArgumentParser) -> list[str]:
    return [name for action in parser._actions for name in action.option_strings if name.startswith("--")]


def _values(parser: argparse.ArgumentParser) -> set[str]:
    """Return the branches for options that take a value: their choices, files, or nothing."""
    branches = set()
    for action in parser._actions:
        if not action.option_strings or action.nargs == 0:
            continue
        reply = f'compgen -W "{" ".join(map(str, action.choices))}"' if action.choices else 'compgen -W ""'
        if action.metavar == "FILE":
            reply = "compgen -f"
        branches.add(f'    {"|".join(action.option_strings)}) COMPREPLY=($({reply} -- "$word")); return ;;')
    return branches
