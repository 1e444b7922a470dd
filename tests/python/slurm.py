"""Slurm on this machine: one node with all its cores, without systemd and accounting."""

import os
import shutil
import subprocess
import time
from pathlib import Path

CONFIGURATION = Path("/etc/slurm/slurm.conf")
PACKAGES = ["slurmctld", "slurmd", "slurm-client", "munge"]

# Memory is counted per process and limited per step, as there are no control groups.
TEXT = """ClusterName=test
SlurmctldHost={host}(127.0.0.1)
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket={folder}/munge.socket
MpiDefault=none
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
JobAcctGatherType=jobacct_gather/linux
JobAcctGatherFrequency=1
JobAcctGatherParams=OverMemoryKill
AccountingStorageType=accounting_storage/none
ReturnToService=2
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
SlurmctldPort=16817
SlurmdPort=16818
SchedulerParameters=sched_interval=1
KillWait=2
MinJobAge=3600
NodeName={host} NodeAddr=127.0.0.1 CPUs={cores} RealMemory={memory_mb} State=UNKNOWN
PartitionName=main Nodes=ALL Default=YES MaxTime=INFINITE State=UP
"""


def obstacle():
    """Installs Debian's packages; returns why Slurm cannot be started here, if so."""
    if os.geteuid() != 0:
        return "only root can start it"
    if CONFIGURATION.exists():
        return f"{CONFIGURATION} exists: this machine belongs to a cluster"
    if all(shutil.which(program) for program in ["slurmctld", "slurmd", "munged", "sbatch"]):
        return None
    environment = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
    install = ["apt-get", "install", "-y", "-qq", "--no-install-recommends", *PACKAGES]
    for command in [["apt-get", "update", "-qq"], install]:
        try:
            done = subprocess.run(command, env=environment, capture_output=True, timeout=300, check=False)
        except (OSError, subprocess.TimeoutExpired) as error:
            return f"{' '.join(PACKAGES)} cannot be installed: {error}"
        if done.returncode != 0:
            return f"{' '.join(PACKAGES)} are not here and cannot be installed"
    return None


class Slurm:
    """Starts munged, slurmctld and slurmd, and ends them."""

    def __init__(self, folder):
        self.folder = Path(folder)
        self.daemons = []

    def __enter__(self):
        folder = self.folder
        for name in ["state", "spool"]:
            (folder / name).mkdir(parents=True)
        for path in [folder, *folder.parents]:
            path.chmod(path.stat().st_mode | 0o055) if path.stat().st_uid == os.geteuid() else None
        host = os.uname().nodename.split(".")[0]
        memory_mb = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 1_100_000
        CONFIGURATION.parent.mkdir(exist_ok=True)
        CONFIGURATION.write_text(
            TEXT.format(host=host, folder=folder, cores=os.cpu_count(), memory_mb=memory_mb), encoding="utf-8")
        key = folder / "munge.key"
        key.write_bytes(os.urandom(1024))
        key.chmod(0o400)
        files = {"key-file": key, "socket": folder / "munge.socket", "pid-file": folder / "munged.pid",
                 "log-file": folder / "munged.log", "seed-file": folder / "munged.seed"}
        self.start("munged", "--foreground", "--force", *(f"--{name}={path}" for name, path in files.items()))
        time.sleep(1)
        self.start("slurmctld", "-D", "-c")
        self.start("slurmd", "-D", "-c")
        end = time.monotonic() + 30
        while self.ask("sinfo", "--noheader", "--format=%t") != "idle":
            if time.monotonic() > end:
                self.__exit__()
                raise TimeoutError(f"Slurm does not start: {self.messages()}")
            time.sleep(0.2)
        return self

    def __exit__(self, kind=None, *_):
        if kind:
            print(self.ask("sinfo", "--long", "--list-reasons"), self.ask("squeue", "--long"), self.messages(), sep="\n")
        for daemon in reversed(self.daemons):
            daemon.terminate()
        for daemon in reversed(self.daemons):
            try:
                daemon.wait(timeout=10)
            except subprocess.TimeoutExpired:
                daemon.kill()
        CONFIGURATION.unlink(missing_ok=True)

    def start(self, program, *arguments):
        out = open(self.folder / f"{program}.out", "wb")
        self.daemons.append(subprocess.Popen([program, *arguments], stdout=out, stderr=subprocess.STDOUT))

    def messages(self):
        return "".join(file.read_text(errors="replace")[-2000:] for file in self.folder.glob("*.out"))

    def ask(self, *command):
        """Output of a command of Slurm."""
        done = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)
        return done.stdout.strip()

    def drain(self, is_drained):
        """Drains the node, or returns it to service."""
        state = ["State=DRAIN", "Reason=test"] if is_drained else ["State=RESUME"]
        self.ask("scontrol", "update", f"NodeName={os.uname().nodename.split('.')[0]}", *state)

    def jobs(self, name=""):
        """All jobs whose comment contains the name, as tables of their properties."""
        text = self.ask("scontrol", "show", "job", "--oneliner")
        jobs = [dict(word.split("=", 1) for word in line.split() if "=" in word) for line in text.splitlines()]
        return [job for job in jobs if name in job.get("Comment", "")]

    def is_idle(self):
        return not any(job["JobState"] in ("PENDING", "RUNNING", "COMPLETING") for job in self.jobs())
