#!/usr/bin/env bash
#SBATCH --job-name=piezomat
#SBATCH --ntasks=8
#SBATCH --mem-per-cpu=4G
#SBATCH --time=08:00:00
#SBATCH --output=piezomat-%j.log
#
# A batch job: one scene on many ranks. With SLURM, from the project's folder; options before the script's name take the
# place of the lines above:
#
#     sbatch --ntasks=16 scripts/batch.sh SCENE RESULTS [--set KEY=VALUE ...]
#
# By hand, on this machine (RANKS: default 2):
#
#     RANKS=4 scripts/batch.sh SCENE RESULTS [--set KEY=VALUE ...]
#
# The same command continues a job that ended before its run (time limit, failure of a node): if RESULTS contains an
# unfinished run, it is resumed from its last converged step, on the present number of ranks, with the copy of the scene
# in RESULTS. A run that ended before its first checkpoint starts again. A finished run is not repeated: give another
# RESULTS for another run.
#
# PYTHON names the interpreter (default: the project's .venv), LAUNCHER what starts the ranks (default: mpirun).

set -euo pipefail

# SLURM runs a copy of this script from elsewhere.
root=${SLURM_SUBMIT_DIR:-$(cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/.." && pwd)}
python=${PYTHON:-$root/.venv/bin/python}
ranks=${SLURM_NTASKS:-${RANKS:-2}}

if (($# < 2)); then
    printf 'usage: scripts/batch.sh SCENE RESULTS [--set KEY=VALUE ...]\n' >&2
    exit 2
fi
scene=$1 results=$2
shift 2
if [[ ! -x $python ]]; then
    printf 'scripts/batch.sh: no %s: run scripts/run once, or set PYTHON\n' "$python" >&2
    exit 1
fi

# One thread a rank: the ranks are what runs in parallel.
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
launch=(mpirun -n "$ranks")
if [[ -n ${LAUNCHER:-} ]]; then
    read -ra launch <<<"$LAUNCHER" # such as "srun --mpi=pmix"
elif [[ -z ${SLURM_JOB_ID:-} ]]; then
    # By hand, more ranks than cores are allowed, in the words of Open MPI 4 and 5.
    export OMPI_MCA_rmaps_base_oversubscribe=1 PRTE_MCA_rmaps_default_mapping_policy=:oversubscribe
fi
if [[ $EUID == 0 ]]; then
    export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1
fi

shopt -s nullglob
checkpoints=("$results"/checkpoint/step_*.npz)
command=(run "$scene" --out "$results" "$@")
if [[ -f $results/summary.json ]] && grep -Eq '"converged": *true' "$results/summary.json"; then
    printf '%s holds a run that is done\n' "$results"
    exit 0
elif ((${#checkpoints[@]} > 0)); then
    command=(resume "$results")
fi
printf 'piezomat %s on %s ranks\n' "${command[*]}" "$ranks"
# mpi4py ends all ranks when one of them ends in error.
exec "${launch[@]}" "$python" -m mpi4py -m piezomat "${command[@]}"
