// Faults of a machine, for tests: a library that LD_PRELOAD puts before the C library's calls.
//
// NEUROTACT_FAULT_IN=FOLDER     the calls that count are those which write, rename or remove a file below it
// NEUROTACT_FAULT_LOG=FILE      counts them: a line each, "PID CALL PATH BYTES"
// NEUROTACT_KILL_AT=N           SIGKILL to the process (with NEUROTACT_KILL_GROUP=1 to its group) in the middle of the
//                               Nth of them: half of the bytes are written; a rename or removal is done or not, in turn
// NEUROTACT_CLOCK=SECONDS       the wall clock jumps by so much at every second look at it, there and back
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/time.h>
#include <sys/uio.h>
#include <time.h>
#include <unistd.h>

#define REAL(type, name, ...) \
    static type (*real)(__VA_ARGS__); \
    if (!real) real = (type (*)(__VA_ARGS__))dlsym(RTLD_NEXT, name)

static long calls;  // of this process; a forked one goes on counting

static long number(const char* name) {
    const char* text = getenv(name);
    return text ? atol(text) : 0;
}

static int is_below(const char* path) {
    const char* folder = getenv("NEUROTACT_FAULT_IN");
    return folder && *folder && !strncmp(path, folder, strlen(folder)) && path[strlen(folder)] == '/';
}

static int path_of(int fd, char* path, size_t size) {
    char link[64];
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    const ssize_t n = readlink(link, path, size - 1);
    path[n > 0 ? n : 0] = 0;
    return n > 0;
}

static void absolute(const char* path, char* found, size_t size) {
    if (path[0] == '/' || !getcwd(found, size)) found[0] = 0;
    snprintf(found + strlen(found), size - strlen(found), "%s%s", path[0] == '/' ? "" : "/", path);
}

static void note(const char* call, const char* path, size_t bytes) {
    const char* log = getenv("NEUROTACT_FAULT_LOG");
    if (!log) return;
    char line[4400];
    const int n = snprintf(line, sizeof line, "%d %s %s %zu\n", getpid(), call, path, bytes);
    const int fd = open(log, O_WRONLY | O_CREAT | O_APPEND, 0666);
    if (fd < 0) return;
    REAL(ssize_t, "write", int, const void*, size_t);
    if (real(fd, line, (size_t)n) < 0) _exit(99);
    close(fd);
}

// Whether this call is the one that kills; it is counted and noted.
static int is_last(const char* call, const char* path, size_t bytes) {
    if (!is_below(path)) return 0;
    calls++;
    note(call, path, bytes);
    return calls == number("NEUROTACT_KILL_AT");
}

static void die(void) {
    kill(number("NEUROTACT_KILL_GROUP") ? 0 : getpid(), SIGKILL);
    for (;;) pause();
}

ssize_t write(int fd, const void* bytes, size_t n) {
    REAL(ssize_t, "write", int, const void*, size_t);
    char path[4096];
    if (getenv("NEUROTACT_FAULT_IN") && path_of(fd, path, sizeof path) && is_last("write", path, n)) {
        real(fd, bytes, n / 2);
        die();
    }
    return real(fd, bytes, n);
}

ssize_t writev(int fd, const struct iovec* parts, int n) {
    REAL(ssize_t, "writev", int, const struct iovec*, int);
    char path[4096];
    if (getenv("NEUROTACT_FAULT_IN") && path_of(fd, path, sizeof path) && is_last("writev", path, (size_t)n)) {
        real(fd, parts, n / 2);
        die();
    }
    return real(fd, parts, n);
}

static ssize_t at(const char* name, int fd, const void* bytes, size_t n, off64_t offset) {
    REAL(ssize_t, "pwrite64", int, const void*, size_t, off64_t);
    char path[4096];
    if (getenv("NEUROTACT_FAULT_IN") && path_of(fd, path, sizeof path) && is_last(name, path, n)) {
        real(fd, bytes, n / 2, offset);
        die();
    }
    return real(fd, bytes, n, offset);
}

ssize_t pwrite(int fd, const void* bytes, size_t n, off_t offset) { return at("pwrite", fd, bytes, n, offset); }
ssize_t pwrite64(int fd, const void* bytes, size_t n, off64_t offset) { return at("pwrite64", fd, bytes, n, offset); }

int rename(const char* from, const char* to) {
    REAL(int, "rename", const char*, const char*);
    char path[8192];
    absolute(to, path, sizeof path);
    if (is_last("rename", path, 0)) {
        if (calls % 2) real(from, to);
        die();
    }
    return real(from, to);
}

int unlink(const char* file) {
    REAL(int, "unlink", const char*);
    char path[8192];
    absolute(file, path, sizeof path);
    if (is_last("unlink", path, 0)) {
        if (calls % 2) real(file);
        die();
    }
    return real(file);
}

int clock_gettime(clockid_t which, struct timespec* now) {
    REAL(int, "clock_gettime", clockid_t, struct timespec*);
    static long looks;
    const int done = real(which, now);
    if (which == CLOCK_REALTIME && looks++ % 2) now->tv_sec += number("NEUROTACT_CLOCK");
    return done;
}

time_t time(time_t* at) {
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    if (at) *at = now.tv_sec;
    return now.tv_sec;
}

int gettimeofday(struct timeval* restrict now, void* restrict zone) {
    (void)zone;
    struct timespec found;
    clock_gettime(CLOCK_REALTIME, &found);
    *now = (struct timeval){.tv_sec = found.tv_sec, .tv_usec = found.tv_nsec / 1000};
    return 0;
}
