/* inject FOLDER KIND NUMBER REPORT PROGRAM ARGUMENT...
 *
 * Runs a program under ptrace. The call of that NUMBER (from 1) by which it changes something in FOLDER does not happen, and
 * fails with an error: ENOSPC (this one and all later ones, but removals, as on a full disk), EIO or EINTR (this one alone); with
 * SHORT it is a write that writes half. REPORT gets the name of the call, or nothing if there were fewer. The status is that of the
 * program, 128 and the number of the signal that ended it, or 77 where no process can be traced.
 */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <sys/user.h>
#include <sys/wait.h>
#include <unistd.h>

#if defined(__x86_64__) && defined(PTRACE_GET_SYSCALL_INFO)

static const char *folder;

static int is_inside(const char *path)
{
    size_t length = strlen(folder);
    return strncmp(path, folder, length) == 0 && (path[length] == '/' || path[length] == 0);
}

static int inside_descriptor(pid_t pid, int descriptor)
{
    char link[64], path[PATH_MAX];
    if (descriptor == AT_FDCWD)
        snprintf(link, sizeof link, "/proc/%d/cwd", pid);
    else
        snprintf(link, sizeof link, "/proc/%d/fd/%d", pid, descriptor);
    ssize_t length = readlink(link, path, sizeof path - 1);
    if (length < 0)
        return 0;
    path[length] = 0;
    return is_inside(path);
}

/* Names that contain `..` are not resolved: no command of the tests has them. */
static int inside_path(pid_t pid, int descriptor, uint64_t address)
{
    char path[PATH_MAX] = "", whole[2 * PATH_MAX];
    struct iovec here = { path, sizeof path - 1 }, there = { (void *)address, sizeof path - 1 };
    ssize_t got = process_vm_readv(pid, &here, 1, &there, 1, 0);
    if (got < 0) {
        /* The text ends near the end of a page. */
        here.iov_len = there.iov_len = 4096 - address % 4096;
        got = process_vm_readv(pid, &here, 1, &there, 1, 0);
        if (got < 0)
            return 0;
    }
    if (path[0] == '/')
        return is_inside(path);
    char link[64], base[PATH_MAX];
    if (descriptor == AT_FDCWD)
        snprintf(link, sizeof link, "/proc/%d/cwd", pid);
    else
        snprintf(link, sizeof link, "/proc/%d/fd/%d", pid, descriptor);
    ssize_t length = readlink(link, base, sizeof base - 1);
    if (length < 0)
        return 0;
    base[length] = 0;
    snprintf(whole, sizeof whole, "%s/%s", base, path);
    return is_inside(whole);
}

/* The name of a call that changes something in the folder; none of other calls. */
static const char *change(pid_t pid, uint64_t number, const uint64_t *a)
{
    const uint64_t writing = O_WRONLY | O_RDWR | O_CREAT | O_TRUNC;
    switch (number) {
    case SYS_write: return inside_descriptor(pid, a[0]) ? "write" : NULL;
    case SYS_pwrite64: return inside_descriptor(pid, a[0]) ? "pwrite" : NULL;
    case SYS_writev: return inside_descriptor(pid, a[0]) ? "writev" : NULL;
    case SYS_ftruncate: return inside_descriptor(pid, a[0]) ? "ftruncate" : NULL;
    case SYS_fallocate: return inside_descriptor(pid, a[0]) ? "fallocate" : NULL;
    case SYS_fsync: return inside_descriptor(pid, a[0]) ? "fsync" : NULL;
    case SYS_fdatasync: return inside_descriptor(pid, a[0]) ? "fdatasync" : NULL;
    case SYS_fchmod: return inside_descriptor(pid, a[0]) ? "fchmod" : NULL;
    case SYS_copy_file_range: return inside_descriptor(pid, a[2]) ? "copy_file_range" : NULL;
    case SYS_openat: return (a[2] & writing) && inside_path(pid, a[0], a[1]) ? "openat" : NULL;
    case SYS_open: return (a[1] & writing) && inside_path(pid, AT_FDCWD, a[0]) ? "open" : NULL;
    case SYS_mkdir: return inside_path(pid, AT_FDCWD, a[0]) ? "mkdir" : NULL;
    case SYS_mkdirat: return inside_path(pid, a[0], a[1]) ? "mkdirat" : NULL;
    case SYS_rename: return inside_path(pid, AT_FDCWD, a[0]) ? "rename" : NULL;
    case SYS_renameat: return inside_path(pid, a[0], a[1]) ? "renameat" : NULL;
    case SYS_renameat2: return inside_path(pid, a[0], a[1]) ? "renameat2" : NULL;
    case SYS_link: return inside_path(pid, AT_FDCWD, a[1]) ? "link" : NULL;
    case SYS_linkat: return inside_path(pid, a[2], a[3]) ? "linkat" : NULL;
    case SYS_unlink: return inside_path(pid, AT_FDCWD, a[0]) ? "unlink" : NULL;
    case SYS_unlinkat: return inside_path(pid, a[0], a[1]) ? "unlinkat" : NULL;
    case SYS_rmdir: return inside_path(pid, AT_FDCWD, a[0]) ? "rmdir" : NULL;
    default: return NULL;
    }
}

static int is_removal(const char *name)
{
    return strncmp(name, "unlink", 6) == 0 || strcmp(name, "rmdir") == 0;
}

/* Threads whose call was skipped, and with which error. */
static struct { pid_t thread; int error; } skipped[256];

static int *slot(pid_t thread)
{
    int free_one = 0;
    for (int i = 0; i < 256; i++) {
        if (skipped[i].thread == thread)
            return &skipped[i].error;
        if (skipped[i].thread == 0)
            free_one = i;
    }
    skipped[free_one].thread = thread;
    return &skipped[free_one].error;
}

int main(int count, char **given)
{
    if (count < 6)
        return 2;
    folder = given[1];
    const char *kind = given[2];
    int is_short = strcmp(kind, "SHORT") == 0, is_full = strcmp(kind, "ENOSPC") == 0;
    int error = is_full ? ENOSPC : strcmp(kind, "EIO") == 0 ? EIO : EINTR;
    long wanted = atol(given[3]), seen = 0;
    FILE *report = fopen(given[4], "w");
    pid_t child = fork();
    if (child == 0) {
        if (ptrace(PTRACE_TRACEME, 0, NULL, NULL) != 0)
            _exit(77);
        raise(SIGSTOP);
        execv(given[5], given + 5);
        _exit(77);
    }
    int status;
    if (child < 0 || !report || waitpid(child, &status, 0) < 0 || !WIFSTOPPED(status))
        return 77;
    long options = PTRACE_O_TRACESYSGOOD | PTRACE_O_TRACECLONE | PTRACE_O_TRACEFORK | PTRACE_O_TRACEVFORK | PTRACE_O_EXITKILL;
    if (ptrace(PTRACE_SETOPTIONS, child, NULL, options) != 0 || ptrace(PTRACE_SYSCALL, child, NULL, NULL) != 0)
        return 77;
    int result = 77;
    for (;;) {
        pid_t thread = waitpid(-1, &status, __WALL);
        if (thread < 0)
            break;
        if (WIFEXITED(status) || WIFSIGNALED(status)) {
            if (thread == child)
                result = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
            continue;
        }
        int signal = WSTOPSIG(status);
        if (signal != (SIGTRAP | 0x80)) {
            /* New threads begin with a stop; events of ptrace are traps. */
            int is_own = signal == SIGTRAP || signal == SIGSTOP;
            ptrace(PTRACE_SYSCALL, thread, NULL, is_own ? 0L : (long)signal);
            continue;
        }
        struct __ptrace_syscall_info info;
        struct user_regs_struct registers;
        if (ptrace(PTRACE_GET_SYSCALL_INFO, thread, sizeof info, &info) > 0 &&
            ptrace(PTRACE_GETREGS, thread, NULL, &registers) == 0) {
            int *error_of = slot(thread);
            if (info.op == PTRACE_SYSCALL_INFO_ENTRY) {
                const char *name = change(thread, info.entry.nr, info.entry.args);
                int counts = name && !(is_short && strcmp(name, "write") != 0 && strcmp(name, "pwrite") != 0) &&
                             !(is_full && is_removal(name));
                seen += counts;
                if (counts && (seen == wanted || (is_full && seen > wanted))) {
                    if (seen == wanted)
                        fprintf(report, "%s\n", name);
                    if (is_short) {
                        registers.rdx = registers.rdx > 1 ? registers.rdx / 2 : registers.rdx;
                    } else {
                        registers.orig_rax = (unsigned long long)-1;
                        *error_of = error;
                    }
                    ptrace(PTRACE_SETREGS, thread, NULL, &registers);
                }
            } else if (info.op == PTRACE_SYSCALL_INFO_EXIT && *error_of) {
                registers.rax = (unsigned long long)-*error_of;
                *error_of = 0;
                ptrace(PTRACE_SETREGS, thread, NULL, &registers);
            }
        }
        ptrace(PTRACE_SYSCALL, thread, NULL, NULL);
    }
    fclose(report);
    return result;
}

#else

int main(void)
{
    return 77;
}

#endif
