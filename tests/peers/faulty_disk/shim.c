/* A disk that fails, for the tests of the journal: loaded with LD_PRELOAD before libc, it stands
 * between a program and the files below the folder $FAULTY_DISK. What it does is set by:
 *
 *   FAULTY_FULL_AFTER=N     ENOSPC once N bytes were written; the write before it comes up short
 *   FAULTY_WRITE_AFTER=N    EIO from the Nth write on
 *   FAULTY_SYNC_AFTER=N     EIO from the Nth sync on
 *   FAULTY_SYNC_ONCE=N      EIO at the Nth sync alone
 *   FAULTY_SHORT=1          writes of more than one byte do the first half only
 *   FAULTY_SLOW_MS=N        every sync takes N ms longer
 *   FAULTY_LOG=FILE         write down, in their order, what reaches the disk and what is sent:
 *
 *   E id path       a file that was there was opened     C id path      a file was made
 *   M path          a folder was made                    U path         a name was taken away
 *   R from\tto      a name was changed                   D path         a folder was synced
 *   W id at length  written, the bytes follow            T id length    cut or grown
 *   S id            a file was synced                    N length       sent, the bytes follow
 *   P length        printed on standard output
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <time.h>
#include <unistd.h>

enum { FDS = 4096, FILES = 4096 };

static pthread_mutex_t mutex = PTHREAD_MUTEX_INITIALIZER;
static const char *folder;
static int log_fd = -1;
static long full_after = -1, write_after = -1, sync_after = -1, sync_once = -1, slow_ms, is_short;
static long written, writes, syncs;
/* What each descriptor is open on: a file's id from 1, -1 for a folder. */
static int id_of[FDS];
static char *folder_of[FDS];
/* The name of each file, by its id; taken away with it. */
static char *name_of[FILES];
static int files;

#define REAL(type, name, ...)                                                                      \
    static type (*real)(__VA_ARGS__);                                                              \
    if (!real) real = (type(*)(__VA_ARGS__))dlsym(RTLD_NEXT, name)

static long number(const char *name) {
    const char *text = getenv(name);
    return text ? atol(text) : -1;
}

__attribute__((constructor)) static void start(void) {
    folder = getenv("FAULTY_DISK");
    full_after = number("FAULTY_FULL_AFTER");
    write_after = number("FAULTY_WRITE_AFTER");
    sync_after = number("FAULTY_SYNC_AFTER");
    sync_once = number("FAULTY_SYNC_ONCE");
    slow_ms = number("FAULTY_SLOW_MS");
    is_short = number("FAULTY_SHORT");
    int (*real_open)(const char *, int, ...) = (int (*)(const char *, int, ...))dlsym(RTLD_NEXT, "open");
    const char *path = getenv("FAULTY_LOG");
    if (path) log_fd = real_open(path, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0600);
}

static ssize_t real_write(int fd, const void *from, size_t count) {
    REAL(ssize_t, "write", int, const void *, size_t);
    return real(fd, from, count);
}

static void note(const void *data, size_t length, const char *format, ...) {
    if (log_fd < 0) return;
    char line[PATH_MAX * 2 + 64];
    va_list list;
    va_start(list, format);
    int head = vsnprintf(line, sizeof line, format, list);
    va_end(list);
    if (real_write(log_fd, line, head) != head) abort();
    if (length && real_write(log_fd, data, length) != (ssize_t)length) abort();
}

/* Is it on this disk? */
static int here(const char *path) {
    return folder && path && !strncmp(path, folder, strlen(folder));
}

static int known(int fd) { return fd >= 0 && fd < FDS ? id_of[fd] : 0; }

static void opened(int fd, const char *path, int flags, int existed) {
    if (fd < 0 || fd >= FDS) return;
    struct stat status;
    if (fstat(fd, &status)) return;
    if (S_ISDIR(status.st_mode)) {
        id_of[fd] = -1;
        free(folder_of[fd]);
        folder_of[fd] = strdup(path);
        return;
    }
    int id = 0;
    for (int i = 1; i <= files && existed; i++)
        if (name_of[i] && !strcmp(name_of[i], path)) id = i;
    if (!id && files + 1 < FILES) {
        id = ++files;
        name_of[id] = strdup(path);
        note(0, 0, "%c %d %s\n", existed ? 'E' : 'C', id, path);
    }
    id_of[fd] = id;
    if ((flags & O_TRUNC) && existed) note(0, 0, "T %d 0\n", id);
}

static int open_any(const char *name, int at, const char *path, int flags, mode_t mode) {
    int (*real)(int, const char *, int, ...) = (int (*)(int, const char *, int, ...))dlsym(RTLD_NEXT, name);
    if (!here(path)) return real(at, path, flags, mode);
    pthread_mutex_lock(&mutex);
    int existed = !access(path, F_OK);
    int fd = real(at, path, flags, mode);
    int kept = errno;
    opened(fd, path, flags, existed);
    pthread_mutex_unlock(&mutex);
    errno = kept;
    return fd;
}

int open(const char *path, int flags, ...) {
    va_list list;
    va_start(list, flags);
    mode_t mode = (flags & O_CREAT) ? va_arg(list, mode_t) : 0;
    va_end(list);
    return open_any("openat", AT_FDCWD, path, flags, mode);
}

int open64(const char *path, int flags, ...) {
    va_list list;
    va_start(list, flags);
    mode_t mode = (flags & O_CREAT) ? va_arg(list, mode_t) : 0;
    va_end(list);
    return open_any("openat64", AT_FDCWD, path, flags, mode);
}

int close(int fd) {
    REAL(int, "close", int);
    if (known(fd)) {
        pthread_mutex_lock(&mutex);
        id_of[fd] = 0;
        pthread_mutex_unlock(&mutex);
    }
    return real(fd);
}

/* How much of a write this disk takes; -1 with errno if nothing. */
static ssize_t taken(size_t count) {
    if (write_after >= 0 && writes++ >= write_after) return errno = EIO, -1;
    if (full_after >= 0 && written + (long)count > full_after) {
        if (written >= full_after) return errno = ENOSPC, -1;
        count = full_after - written;
    }
    if (is_short > 0 && count > 1) count /= 2;
    written += count;
    return count;
}

static ssize_t write_at(int fd, const void *from, size_t count, off64_t at) {
    REAL(ssize_t, "pwrite64", int, const void *, size_t, off64_t);
    if (known(fd) <= 0) return real(fd, from, count, at);
    pthread_mutex_lock(&mutex);
    ssize_t done = taken(count);
    if (done > 0) done = real(fd, from, done, at);
    if (done > 0) note(from, done, "W %d %lld %zd\n", id_of[fd], (long long)at, done);
    pthread_mutex_unlock(&mutex);
    return done;
}

ssize_t pwrite(int fd, const void *from, size_t count, off_t at) { return write_at(fd, from, count, at); }
ssize_t pwrite64(int fd, const void *from, size_t count, off64_t at) { return write_at(fd, from, count, at); }

ssize_t write(int fd, const void *from, size_t count) {
    if (fd == STDOUT_FILENO) {
        pthread_mutex_lock(&mutex);
        note(0, 0, "P %zu\n", count);
        pthread_mutex_unlock(&mutex);
    }
    if (known(fd) <= 0) return real_write(fd, from, count);
    pthread_mutex_lock(&mutex);
    off64_t at = lseek64(fd, 0, SEEK_CUR);
    ssize_t done = taken(count);
    if (done > 0) done = real_write(fd, from, done);
    if (done > 0) note(from, done, "W %d %lld %zd\n", id_of[fd], (long long)at, done);
    pthread_mutex_unlock(&mutex);
    return done;
}

static int resize(const char *name, int fd, off64_t length) {
    int (*real)(int, off64_t) = (int (*)(int, off64_t))dlsym(RTLD_NEXT, name);
    pthread_mutex_lock(&mutex);
    int ended = real(fd, length);
    if (!ended && known(fd) > 0) note(0, 0, "T %d %lld\n", id_of[fd], (long long)length);
    pthread_mutex_unlock(&mutex);
    return ended;
}

int ftruncate(int fd, off_t length) { return resize("ftruncate", fd, length); }
int ftruncate64(int fd, off64_t length) { return resize("ftruncate64", fd, length); }

static int sync_any(const char *name, int fd) {
    int (*real)(int) = (int (*)(int))dlsym(RTLD_NEXT, name);
    if (!known(fd)) return real(fd);
    pthread_mutex_lock(&mutex);
    long now = syncs++;
    int ended = 0;
    if ((sync_after >= 0 && now >= sync_after) || now == sync_once) {
        errno = EIO;
        ended = -1;
    } else {
        if (slow_ms > 0) nanosleep(&(struct timespec){slow_ms / 1000, slow_ms % 1000 * 1000000}, 0);
        ended = real(fd);
        if (!ended && id_of[fd] < 0) note(0, 0, "D %s\n", folder_of[fd]);
        if (!ended && id_of[fd] > 0) note(0, 0, "S %d\n", id_of[fd]);
    }
    pthread_mutex_unlock(&mutex);
    return ended;
}

int fsync(int fd) { return sync_any("fsync", fd); }
int fdatasync(int fd) { return sync_any("fdatasync", fd); }

static void forget(const char *path) {
    for (int i = 1; i <= files; i++)
        if (name_of[i] && !strcmp(name_of[i], path)) {
            free(name_of[i]);
            name_of[i] = 0;
        }
}

int unlink(const char *path) {
    REAL(int, "unlink", const char *);
    if (!here(path)) return real(path);
    pthread_mutex_lock(&mutex);
    int ended = real(path);
    if (!ended) {
        note(0, 0, "U %s\n", path);
        forget(path);
    }
    pthread_mutex_unlock(&mutex);
    return ended;
}

int rename(const char *from, const char *to) {
    REAL(int, "rename", const char *, const char *);
    if (!here(from)) return real(from, to);
    pthread_mutex_lock(&mutex);
    int ended = real(from, to);
    if (!ended) {
        note(0, 0, "R %s\t%s\n", from, to);
        forget(to);
        for (int i = 1; i <= files; i++)
            if (name_of[i] && !strcmp(name_of[i], from)) {
                free(name_of[i]);
                name_of[i] = strdup(to);
            }
    }
    pthread_mutex_unlock(&mutex);
    return ended;
}

int mkdir(const char *path, mode_t mode) {
    REAL(int, "mkdir", const char *, mode_t);
    if (!here(path)) return real(path, mode);
    pthread_mutex_lock(&mutex);
    int ended = real(path, mode);
    if (!ended) note(0, 0, "M %s\n", path);
    pthread_mutex_unlock(&mutex);
    return ended;
}

/* What goes to the machine: noted before it goes. */
ssize_t send(int fd, const void *from, size_t count, int flags) {
    REAL(ssize_t, "send", int, const void *, size_t, int);
    pthread_mutex_lock(&mutex);
    note(from, count, "N %zu\n", count);
    pthread_mutex_unlock(&mutex);
    return real(fd, from, count, flags);
}

ssize_t writev(int fd, const struct iovec *parts, int count) {
    REAL(ssize_t, "writev", int, const struct iovec *, int);
    pthread_mutex_lock(&mutex);
    for (int i = 0; i < count; i++) note(parts[i].iov_base, parts[i].iov_len, "N %zu\n", parts[i].iov_len);
    pthread_mutex_unlock(&mutex);
    return real(fd, parts, count);
}
