#!/usr/bin/env bash
# Prints the README's figures of the walker: the demonstration's, then those of each seed, none left out.
# usage: [PARAMETERS=FILE] scripts/walker_figures.bash OUTPUT [HIDDEN] [ITERATIONS] [SEED...]
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
source env.bash

output=${1:?walker_figures: name a folder for the results} hidden=${2:-10} iterations=${3:-50}
seeds=("${@:4}") parameters=()
[[ -z ${PARAMETERS:-} ]] || parameters=(--params-file "$PARAMETERS")
[[ ${#seeds[@]} -gt 0 ]] || seeds=(0 1 2 3 4)

survival() {  # survival NAME FOLDER [arguments of evaluate]: prints one share
  local name=$1 folder=$2
  shift 2
  vgps evaluate "$folder" --seed 5 "$@" --json "$folder/$name.json" --overwrite >/dev/null
  python -c 'import json, sys; print("{:.3f}".format(json.load(open(sys.argv[1]))["survival"]))' \
    "$folder/$name.json"
}

python scripts/demonstration_figures.py
printf '%s hidden units, %s iterations\n' "$hidden" "$iterations"
printf '%-6s %-16s %-14s %-22s %s\n' seed 'cost / DDP cost' '20 s from x_1' 'perturbed starts, 10 s' 'with noise, 4 s'
for seed in "${seeds[@]}"; do
  folder=$output/$hidden-units-seed-$seed
  if [[ ! -e $folder/learning_curve.png ]]; then  # a run that was finished before is kept
    vgps train --task walker "${parameters[@]}" --hidden-units "$hidden" --seed "$seed" \
      --iterations "$iterations" --evaluation-rollouts 4 --output "$folder" >&2
  fi
  ratio=$(python -c '
import json, sys
run = json.load(open(sys.argv[1]))
cost = run["iterations"][-1]["deterministic_cost"]
print("diverged" if cost is None else "{:.3f}".format(cost / run["initial_ddp_cost"]))' \
    "$folder/result.json")
  printf '%-6s %-16s %-14s %-22s %s\n' "$seed" "$ratio" \
    "$(survival from_x1 "$folder" --seconds 20 --rollouts 1 --perturbation 0)" \
    "$(survival perturbed "$folder" --seconds 10 --rollouts 20 --perturbation 0.01)" \
    "$(survival stochastic "$folder" --seconds 4 --rollouts 40 --perturbation 0.01 --stochastic)"
done
