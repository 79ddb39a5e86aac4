/* Preloaded: the system clock runs ahead of the true one by the nanoseconds in the file $CLOCK_JUMP.

   Only CLOCK_REALTIME and what waits by it; the monotonic clock is left alone, as a step of NTP does. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

#define SECOND 1000000000LL
#define SLICE (SECOND / 20)

static volatile const long long *offset_ns;

__attribute__((constructor)) static void map_offset(void) {
    const char *path = getenv("CLOCK_JUMP");
    int file = path ? open(path, O_RDONLY | O_CLOEXEC) : -1;
    void *at = file < 0 ? MAP_FAILED : mmap(0, sizeof(long long), PROT_READ, MAP_SHARED, file, 0);
    if (at != MAP_FAILED) offset_ns = at;
    if (file >= 0) close(file);
}

static long long true_ns(void) {
    struct timespec now;
    syscall(SYS_clock_gettime, CLOCK_REALTIME, &now);
    return now.tv_sec * SECOND + now.tv_nsec;
}

static long long shown_ns(void) { return true_ns() + (offset_ns ? *offset_ns : 0); }

static struct timespec timespec_of(long long ns) {
    return (struct timespec){.tv_sec = ns / SECOND, .tv_nsec = ns % SECOND};
}

int clock_gettime(clockid_t id, struct timespec *now) {
    if (id != CLOCK_REALTIME && id != CLOCK_REALTIME_COARSE) return syscall(SYS_clock_gettime, id, now);
    *now = timespec_of(shown_ns());
    return 0;
}

int gettimeofday(struct timeval *now, void *zone) {
    (void)zone;
    struct timespec shown = timespec_of(shown_ns());
    *now = (struct timeval){.tv_sec = shown.tv_sec, .tv_usec = shown.tv_nsec / 1000};
    return 0;
}

time_t time(time_t *now) {
    time_t shown = shown_ns() / SECOND;
    if (now) *now = shown;
    return shown;
}

/* A wait until a time of the system clock ends when the shown clock gets there. */
int pthread_cond_timedwait(pthread_cond_t *condition, pthread_mutex_t *mutex, const struct timespec *until) {
    static int (*wait)(pthread_cond_t *, pthread_mutex_t *, const struct timespec *);
    if (!wait) wait = dlvsym(RTLD_NEXT, "pthread_cond_timedwait", "GLIBC_2.3.2");
    if (until->tv_sec < SECOND) return wait(condition, mutex, until); /* a monotonic time */
    for (;;) {
        long long left = until->tv_sec * SECOND + until->tv_nsec - shown_ns();
        if (left <= 0) return ETIMEDOUT;
        struct timespec slice = timespec_of(true_ns() + (left < SLICE ? left : SLICE));
        int answer = wait(condition, mutex, &slice);
        if (answer != ETIMEDOUT) return answer;
    }
}
