/* Ends the process by SIGKILL when it is about to make its KILL_AT_FSYNC-th fsync or fdatasync, in whatever thread.
 *
 * Loaded by LD_PRELOAD. strace can do the same, but counts for each thread by itself and makes a start take ten times
 * as long.
 */
#define _GNU_SOURCE
#include <signal.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <sys/syscall.h>
#include <unistd.h>

static atomic_long calls;

static void count(void)
{
    const char *at = getenv("KILL_AT_FSYNC");
    if (at && atomic_fetch_add(&calls, 1) + 1 == atol(at))
        kill(getpid(), SIGKILL);
}

int fsync(int file)
{
    count();
    return (int)syscall(SYS_fsync, file);
}

int fdatasync(int file)
{
    count();
    return (int)syscall(SYS_fdatasync, file);
}
