"""Programs that run our commands: a Slurm of one node, GNU parallel, Ninja. What is not installed, or does not start, is skipped."""

import getpass
import os
import shutil
import socket
import subprocess
import time

from support import check, skip, tools


def program(name):
    path = shutil.which(name)
    if path is None:
        skip("%s is not installed" % name)
    return path


def in_folder(command, folder, timeout=120, env=None):
    r = subprocess.run(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, timeout=timeout, env=env)
    check(r.returncode == 0, "%s: %s" % (command, r.stdout.decode("utf-8", "replace")[-2000:]))
    return r.stdout.decode("utf-8", "replace")


def with_tools(**more):
    return dict(os.environ, PATH="%s:%s" % (tools, os.environ["PATH"]), **more)


SLURM_CONF = """ClusterName=svokit
SlurmctldHost=%(host)s(127.0.0.1)
AuthType=auth/none
CredType=cred/none
SlurmUser=%(user)s
SlurmdUser=%(user)s
SlurmctldPort=%(port0)d
SlurmdPort=%(port1)d
StateSaveLocation=%(folder)s/state
SlurmdSpoolDir=%(folder)s/spool
SlurmctldPidFile=%(folder)s/slurmctld.pid
SlurmdPidFile=%(folder)s/slurmd.pid
ProctrackType=proctrack/pgid
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
MpiDefault=none
AccountingStorageType=accounting_storage/none
JobAcctGatherType=jobacct_gather/none
JobCompType=jobcomp/none
SchedulerParameters=batch_sched_delay=0,sched_min_interval=10000,sched_interval=1
NodeName=%(host)s NodeAddr=127.0.0.1 CPUs=%(cpus)d State=UNKNOWN
PartitionName=all Nodes=ALL Default=YES MaxTime=5 State=UP
"""


class Slurm:
    """A cluster of one node on the loopback interface, with its own ports and state, for as long as a test runs."""

    def __init__(self, folder):
        commands = [program(n) for n in ("slurmctld", "slurmd", "sbatch", "squeue", "sinfo")]
        (folder / "state").mkdir(parents=True)
        (folder / "spool").mkdir()
        sockets = [socket.socket() for _ in range(2)]
        for s in sockets:
            s.bind(("127.0.0.1", 0))
        ports = [s.getsockname()[1] for s in sockets]
        for s in sockets:
            s.close()
        conf = folder / "slurm.conf"
        conf.write_text(SLURM_CONF % {"host": socket.gethostname().split(".")[0], "user": getpass.getuser(), "folder": folder, "port0": ports[0],
                                      "port1": ports[1], "cpus": os.cpu_count()})
        self.env = with_tools(SLURM_CONF=str(conf))
        self.folder, self.daemons = folder, []
        for command in ([commands[0], "-D", "-c"], [commands[1], "-D"]):
            log = open(folder / (os.path.basename(command[0]) + ".log"), "wb")
            self.daemons.append(subprocess.Popen(command, env=self.env, stdout=log, stderr=log, stdin=subprocess.DEVNULL))
            log.close()

    def wait(self, seconds, command, done):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if any(d.poll() is not None for d in self.daemons):
                return False
            r = subprocess.run(command, env=self.env, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, timeout=30)
            if r.returncode == 0 and done(r.stdout.decode()):
                return True
            time.sleep(0.2)
        return False

    def skip_unless_idle(self):
        if not self.wait(20, ["sinfo", "-h", "-o", "%T"], lambda text: "idle" in text):
            skip("a Slurm of one node did not start here: " + self.logs()[-300:].replace("\n", " | "))

    def wait_for_jobs(self, seconds):
        check(self.wait(seconds, ["squeue", "-h"], lambda text: text.strip() == ""), "jobs did not end: " + self.logs())

    def logs(self):
        return "\n".join((self.folder / n).read_text(errors="replace")[-600:] for n in ("slurmctld.log", "slurmd.log"))

    def close(self):
        for d in reversed(self.daemons):
            d.terminate()
        for d in self.daemons:
            try:
                d.wait(10)
            except subprocess.TimeoutExpired:
                d.kill()
                d.wait()
