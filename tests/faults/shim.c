// Fails the n-th call to the C library that concerns files below a folder. Linux, glibc.
//
// Loaded with LD_PRELOAD. Environment:
//   WAVEX_FAULT_BELOW  absolute path of the folder, without links
//   WAVEX_FAULT_KIND   eio, enospc, enospc_sticky, eintr, short or kill
//   WAVEX_FAULT_AT     number of the call that fails, from 1; 0 only counts
//   WAVEX_FAULT_LOG    file for the calls: all of them with WAVEX_FAULT_AT=0, else those that fail
//
// Only calls to which the kind applies are counted: no `stat` is interrupted, no `read` fills a disk.

#define _GNU_SOURCE
#undef _FORTIFY_SOURCE
#include <dirent.h>
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <signal.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

enum kind { NONE, EIO_ONCE, ENOSPC_ONCE, ENOSPC_STICKY, EINTR_ONCE, SHORT, KILL };

// Properties of a call.
enum {
    SPACE = 1,   // may need space on the disk
    SLOW = 2,    // may be interrupted by a signal
    PARTIAL = 4, // may transfer fewer bytes than requested
};

// Calls that a test can ask for: what happens instead.
enum outcome { GO_ON, FAIL, HALF };

#define MOST_FILES 4096

static enum kind kind = NONE;
static long at = 0;
static char below[PATH_MAX];
static char here[PATH_MAX];
static int log_fd = -1;
static atomic_long counted;
// Paths of open files below the folder, by descriptor.
static _Atomic(char *) names[MOST_FILES];

static enum kind kind_of(const char *name) {
    if (!strcmp(name, "eio")) return EIO_ONCE;
    if (!strcmp(name, "enospc")) return ENOSPC_ONCE;
    if (!strcmp(name, "enospc_sticky")) return ENOSPC_STICKY;
    if (!strcmp(name, "eintr")) return EINTR_ONCE;
    if (!strcmp(name, "short")) return SHORT;
    if (!strcmp(name, "kill")) return KILL;
    return NONE;
}

__attribute__((constructor)) static void begin(void) {
    const char *folder = getenv("WAVEX_FAULT_BELOW"), *name = getenv("WAVEX_FAULT_KIND");
    const char *number = getenv("WAVEX_FAULT_AT"), *log = getenv("WAVEX_FAULT_LOG");
    if (!folder || !name || !number || !log) return;
    snprintf(below, sizeof below, "%s", folder);
    if (syscall(SYS_getcwd, here, sizeof here) < 0) here[0] = 0;
    log_fd = (int)syscall(SYS_openat, AT_FDCWD, log, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0644);
    at = atol(number);
    kind = kind_of(name);
}

// Whether a path is below the folder.
static int is_below(const char *path) {
    if (kind == NONE || !path) return 0;
    size_t length = strlen(below);
    if (path[0] != '/') {
        return !strncmp(here, below, length) && (here[length] == '/' || !here[length]);
    }
    return !strncmp(path, below, length) && (path[length] == '/' || !path[length]);
}

static const char *name_of(int fd) {
    return fd >= 0 && fd < MOST_FILES ? atomic_load(&names[fd]) : NULL;
}

// Whether a path is below the folder, if it starts at an open folder.
static int is_below_at(int folder, const char *path) {
    if (kind == NONE || !path) return 0;
    return path[0] == '/' || folder == AT_FDCWD ? is_below(path) : name_of(folder) != NULL;
}

static void opened(int fd, const char *path) {
    // Names are few; they are never freed, because another thread may be reading one.
    if (fd >= 0 && fd < MOST_FILES) atomic_store(&names[fd], strdup(path));
}

static void closed(int fd) {
    if (fd >= 0 && fd < MOST_FILES) atomic_store(&names[fd], NULL);
}

static int applies(int properties) {
    switch (kind) {
    case NONE: return 0;
    case EIO_ONCE:
    case KILL: return 1;
    case ENOSPC_ONCE:
    case ENOSPC_STICKY: return properties & SPACE;
    case EINTR_ONCE: return properties & SLOW;
    case SHORT: return properties & PARTIAL;
    }
    return 0;
}

// Counts a call; sets `errno` if it is to fail.
static enum outcome count(const char *call, const char *path, int properties) {
    if (!applies(properties)) return GO_ON;
    long number = atomic_fetch_add(&counted, 1) + 1;
    int hit = at > 0 && (number == at || (kind == ENOSPC_STICKY && number > at));
    if (hit || at == 0) {
        char line[PATH_MAX + 64];
        int length = snprintf(line, sizeof line, "%s %s\n", call, path);
        if (log_fd >= 0 && length > 0) syscall(SYS_write, log_fd, line, (size_t)length);
    }
    if (!hit) return GO_ON;
    switch (kind) {
    case EIO_ONCE: errno = EIO; return FAIL;
    case ENOSPC_ONCE:
    case ENOSPC_STICKY: errno = ENOSPC; return FAIL;
    case EINTR_ONCE: errno = EINTR; return FAIL;
    case KILL:
        syscall(SYS_kill, syscall(SYS_getpid), SIGKILL);
        for (;;) pause();
    case SHORT: return HALF;
    case NONE: break;
    }
    return GO_ON;
}

#define REAL(name) \
    static __typeof__(&name) real; \
    if (!real) real = (__typeof__(&name))dlsym(RTLD_NEXT, #name)

// Counts a call that concerns a path, and returns from it if it is to fail.
#define PATH(name, path, properties, failed) \
    if (is_below(path) && count(#name, path, properties) == FAIL) return failed

#define PATH_AT(name, folder, path, properties, failed) \
    if (is_below_at(folder, path) && count(#name, path, properties) == FAIL) return failed

// Counts a call that concerns an open file.
#define OPEN_FILE(name, fd, properties, failed) \
    if (name_of(fd) && count(#name, name_of(fd), properties) == FAIL) return failed

// Counts a transfer of `size` bytes, which may become half of them.
#define TRANSFER(name, fd, size, properties) \
    if (name_of(fd)) { \
        enum outcome outcome = count(#name, name_of(fd), properties); \
        if (outcome == FAIL) return -1; \
        if (outcome == HALF && size > 1) size /= 2; \
    }

static int of_open(int flags) { return SLOW | ((flags & O_CREAT) ? SPACE : 0); }

#define OPEN(name) \
    int name(const char *path, int flags, ...) { \
        REAL(name); \
        va_list rest; \
        va_start(rest, flags); \
        mode_t mode = (flags & (O_CREAT | __O_TMPFILE)) ? va_arg(rest, mode_t) : 0; \
        va_end(rest); \
        PATH(name, path, of_open(flags), -1); \
        int fd = real(path, flags, mode); \
        if (is_below(path)) opened(fd, path); \
        return fd; \
    }

OPEN(open)
OPEN(open64)

#define OPENAT(name) \
    int name(int folder, const char *path, int flags, ...) { \
        REAL(name); \
        va_list rest; \
        va_start(rest, flags); \
        mode_t mode = (flags & (O_CREAT | __O_TMPFILE)) ? va_arg(rest, mode_t) : 0; \
        va_end(rest); \
        PATH_AT(name, folder, path, of_open(flags), -1); \
        int fd = real(folder, path, flags, mode); \
        if (is_below_at(folder, path)) opened(fd, path); \
        return fd; \
    }

OPENAT(openat)
OPENAT(openat64)

#define CREAT(name) \
    int name(const char *path, mode_t mode) { \
        REAL(name); \
        PATH(name, path, SLOW | SPACE, -1); \
        int fd = real(path, mode); \
        if (is_below(path)) opened(fd, path); \
        return fd; \
    }

CREAT(creat)
CREAT(creat64)

ssize_t read(int fd, void *to, size_t size) {
    REAL(read);
    TRANSFER(read, fd, size, SLOW | PARTIAL);
    return real(fd, to, size);
}

ssize_t write(int fd, const void *from, size_t size) {
    REAL(write);
    TRANSFER(write, fd, size, SLOW | PARTIAL | SPACE);
    return real(fd, from, size);
}

#define PREAD(name, offset) \
    ssize_t name(int fd, void *to, size_t size, offset from) { \
        REAL(name); \
        TRANSFER(name, fd, size, SLOW | PARTIAL); \
        return real(fd, to, size, from); \
    }

PREAD(pread, off_t)
PREAD(pread64, off64_t)

#define PWRITE(name, offset) \
    ssize_t name(int fd, const void *from, size_t size, offset to) { \
        REAL(name); \
        TRANSFER(name, fd, size, SLOW | PARTIAL | SPACE); \
        return real(fd, from, size, to); \
    }

PWRITE(pwrite, off_t)
PWRITE(pwrite64, off64_t)

// A short transfer of several buffers is half of the first one.
#define VECTOR(name, plain, properties) \
    ssize_t name(int fd, const struct iovec *buffers, int number) { \
        REAL(name); \
        size_t size = 2; \
        TRANSFER(name, fd, size, properties); \
        if (size == 1 && number > 0) { \
            size_t half = (buffers[0].iov_len + 1) / 2; \
            return plain(fd, buffers[0].iov_base, half); \
        } \
        return real(fd, buffers, number); \
    }

static ssize_t plain_read(int fd, void *to, size_t size) { return syscall(SYS_read, fd, to, size); }
static ssize_t plain_write(int fd, void *from, size_t size) { return syscall(SYS_write, fd, from, size); }

VECTOR(readv, plain_read, SLOW | PARTIAL)
VECTOR(writev, plain_write, SLOW | PARTIAL | SPACE)

ssize_t copy_file_range(int from, off64_t *from_at, int to, off64_t *to_at, size_t size, unsigned flags) {
    REAL(copy_file_range);
    TRANSFER(copy_file_range, to, size, PARTIAL | SPACE);
    return real(from, from_at, to, to_at, size, flags);
}

ssize_t sendfile64(int to, int from, off64_t *from_at, size_t size) {
    static ssize_t (*real)(int, int, off64_t *, size_t);
    if (!real) real = (ssize_t(*)(int, int, off64_t *, size_t))dlsym(RTLD_NEXT, "sendfile64");
    TRANSFER(sendfile64, to, size, SLOW | PARTIAL | SPACE);
    return real(to, from, from_at, size);
}

#define SYNC(name) \
    int name(int fd) { \
        REAL(name); \
        OPEN_FILE(name, fd, SLOW | SPACE, -1); \
        return real(fd); \
    }

SYNC(fsync)
SYNC(fdatasync)

#define TRUNCATE(name, offset) \
    int name(int fd, offset size) { \
        REAL(name); \
        OPEN_FILE(name, fd, SLOW | SPACE, -1); \
        return real(fd, size); \
    }

TRUNCATE(ftruncate, off_t)
TRUNCATE(ftruncate64, off64_t)

int flock(int fd, int operation) {
    REAL(flock);
    OPEN_FILE(flock, fd, SLOW, -1);
    return real(fd, operation);
}

#define FCNTL(name) \
    int name(int fd, int command, ...) { \
        REAL(name); \
        va_list rest; \
        va_start(rest, command); \
        void *argument = va_arg(rest, void *); \
        va_end(rest); \
        if (command == F_SETLK || command == F_SETLKW || command == F_OFD_SETLK || command == F_OFD_SETLKW) { \
            OPEN_FILE(name, fd, SLOW, -1); \
        } \
        int result = real(fd, command, argument); \
        int copies = command == F_DUPFD || command == F_DUPFD_CLOEXEC; \
        if (copies && name_of(fd)) opened(result, name_of(fd)); \
        return result; \
    }

FCNTL(fcntl)
FCNTL(fcntl64)

// The file is closed in any case, as by Linux.
int close(int fd) {
    REAL(close);
    const char *name = name_of(fd);
    enum outcome outcome = name ? count("close", name, SLOW) : GO_ON;
    int error = errno;
    closed(fd);
    int result = real(fd);
    if (outcome != FAIL) return result;
    errno = error;
    return -1;
}

#define MMAP(name, offset) \
    void *name(void *address, size_t size, int protection, int flags, int fd, offset from) { \
        REAL(name); \
        OPEN_FILE(name, fd, 0, MAP_FAILED); \
        return real(address, size, protection, flags, fd, from); \
    }

MMAP(mmap, off_t)
MMAP(mmap64, off64_t)

int rename(const char *from, const char *to) {
    REAL(rename);
    PATH(rename, to, SPACE, -1);
    return real(from, to);
}

int renameat(int from_folder, const char *from, int to_folder, const char *to) {
    REAL(renameat);
    PATH_AT(renameat, to_folder, to, SPACE, -1);
    return real(from_folder, from, to_folder, to);
}

int link(const char *from, const char *to) {
    REAL(link);
    PATH(link, to, SPACE, -1);
    return real(from, to);
}

int unlink(const char *path) {
    REAL(unlink);
    PATH(unlink, path, 0, -1);
    return real(path);
}

int unlinkat(int folder, const char *path, int flags) {
    REAL(unlinkat);
    PATH_AT(unlinkat, folder, path, 0, -1);
    return real(folder, path, flags);
}

int rmdir(const char *path) {
    REAL(rmdir);
    PATH(rmdir, path, 0, -1);
    return real(path);
}

int mkdir(const char *path, mode_t mode) {
    REAL(mkdir);
    PATH(mkdir, path, SPACE, -1);
    return real(path, mode);
}

int mkdirat(int folder, const char *path, mode_t mode) {
    REAL(mkdirat);
    PATH_AT(mkdirat, folder, path, SPACE, -1);
    return real(folder, path, mode);
}

#define STAT(name, structure) \
    int name(const char *path, struct structure *about) { \
        REAL(name); \
        PATH(name, path, 0, -1); \
        return real(path, about); \
    }

STAT(stat, stat)
STAT(stat64, stat64)
STAT(lstat, stat)
STAT(lstat64, stat64)

#define FSTAT(name, structure) \
    int name(int fd, struct structure *about) { \
        REAL(name); \
        OPEN_FILE(name, fd, 0, -1); \
        return real(fd, about); \
    }

FSTAT(fstat, stat)
FSTAT(fstat64, stat64)

#define FSTATAT(name, structure) \
    int name(int folder, const char *path, struct structure *about, int flags) { \
        REAL(name); \
        PATH_AT(name, folder, path, 0, -1); \
        return real(folder, path, about, flags); \
    }

FSTATAT(fstatat, stat)
FSTATAT(fstatat64, stat64)

int statx(int folder, const char *path, int flags, unsigned mask, struct statx *about) {
    REAL(statx);
    if (flags & AT_EMPTY_PATH) {
        OPEN_FILE(statx, folder, 0, -1);
    } else {
        PATH_AT(statx, folder, path, 0, -1);
    }
    return real(folder, path, flags, mask, about);
}

DIR *opendir(const char *path) {
    REAL(opendir);
    PATH(opendir, path, 0, NULL);
    DIR *folder = real(path);
    if (folder && is_below(path)) opened(dirfd(folder), path);
    return folder;
}

// Descriptors of folders are used again for other files.
int closedir(DIR *folder) {
    REAL(closedir);
    closed(dirfd(folder));
    return real(folder);
}

struct dirent64 *readdir64(DIR *folder) {
    REAL(readdir64);
    OPEN_FILE(readdir64, dirfd(folder), 0, NULL);
    return real(folder);
}

char *realpath(const char *path, char *to) {
    REAL(realpath);
    PATH(realpath, path, 0, NULL);
    return real(path, to);
}
