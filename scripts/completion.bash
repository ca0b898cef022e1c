# shellcheck shell=bash
# Completes ./koop's commands and their options; source it in bash or zsh. It offers what the reference lists.
[[ -z ${ZSH_VERSION:-} ]] || { autoload -U +X bashcompinit && bashcompinit; }

_koop() {
  local root word=${COMP_WORDS[COMP_CWORD]} command=${COMP_WORDS[1]} words=
  root=$(dirname "$(readlink -f "$(command -v "${COMP_WORDS[0]}")")")
  if ((COMP_CWORD == 1)); then
    words=$(sed -nE 's/^[|] [*][*].koop ([a-z]+).*/\1/p' "$root/docs/reference/commands.md" | sort -u)
  elif [[ $word == -* ]]; then
    words=$(awk -v row="^[|] [*][*].koop ${command}[ \`]" '/^[|] [*][*]/ { inside = $0 ~ row } inside' \
      "$root/docs/reference/commands.md" | grep -oE '`--[a-z-]+' | tr -d '`')
  fi
  # The words hold no spaces.
  # shellcheck disable=SC2207
  COMPREPLY=($(compgen -W "$words" -- "$word"))
}
complete -o default -F _koop koop ./koop
