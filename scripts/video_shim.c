/* A camera without hardware: preloaded, it answers for the device $SHIM_DEVICE as uvcvideo does.

   $SHIM_FRAMES is a file of frames, each its length (32 bits, little-endian) and its bytes; they
   come at $SHIM_RATE per second, over and over. Every 17th is flagged as damaged, every 23rd is
   lost; after $SHIM_FRAMES_TO_LIVE frames the camera is unplugged. See check_video_shim.py. */

#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <linux/videodev2.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/timerfd.h>
#include <time.h>
#include <unistd.h>

#define MOST 32
#define LENGTH (1 << 20)

static int camera = -1, gone, buffers, queue[MOST], queued, exposure = 156, automatic = 3;
static char *memory[MOST], *frames;
static size_t size, position;
static uint32_t sequence, asked_width, asked_height;

static int number(const char *name) { const char *text = getenv(name); return text ? atoi(text) : 0; }

static int refuse(int code) { errno = code; return -1; }

static int start_open(void) {
    FILE *file = fopen(getenv("SHIM_FRAMES"), "rb");
    if (!file) return refuse(ENODEV);
    fseek(file, 0, SEEK_END);
    size = ftell(file);
    rewind(file);
    frames = malloc(size);
    if (fread(frames, 1, size, file) != size) return refuse(EIO);
    fclose(file);
    sequence = position = queued = gone = 0;
    camera = timerfd_create(CLOCK_MONOTONIC, TFD_NONBLOCK | TFD_CLOEXEC);
    return camera;
}

static int any_open(const char *symbol, const char *path, int flags, mode_t mode) {
    const char *device = getenv("SHIM_DEVICE");
    if (device && !strcmp(path, device) && (flags & O_ACCMODE) == O_RDWR) return start_open();
    int (*real)(const char *, int, ...) = dlsym(RTLD_NEXT, symbol);
    return real(path, flags, mode);
}

#define OPEN(name) \
    int name(const char *path, int flags, ...) { \
        va_list rest; va_start(rest, flags); \
        mode_t mode = flags & (O_CREAT | O_TMPFILE) ? va_arg(rest, int) : 0; \
        va_end(rest); \
        return any_open(#name, path, flags, mode); }
OPEN(open)
OPEN(open64)

static void *any_mmap(const char *symbol, void *at, size_t length, int rights, int flags, int fd, off_t offset) {
    if (camera >= 0 && fd == camera) return memory[offset / 4096];
    void *(*real)(void *, size_t, int, int, int, off_t) = dlsym(RTLD_NEXT, symbol);
    return real(at, length, rights, flags, fd, offset);
}

void *mmap(void *at, size_t length, int rights, int flags, int fd, off_t offset) {
    return any_mmap("mmap", at, length, rights, flags, fd, offset);
}

void *mmap64(void *at, size_t length, int rights, int flags, int fd, off_t offset) {
    return any_mmap("mmap64", at, length, rights, flags, fd, offset);
}

static int request_buffers(struct v4l2_requestbuffers *request) {
    if (request->count > MOST) request->count = MOST;
    buffers = request->count;
    for (int i = 0; i < buffers; i++)
        memory[i] = mmap(NULL, LENGTH, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    return 0;
}

static int stream_on(void) {
    long nanoseconds = 1000000000L / number("SHIM_RATE");
    struct itimerspec every = {{0, nanoseconds}, {0, nanoseconds}};
    return timerfd_settime(camera, 0, &every, NULL);
}

static int dequeue(struct v4l2_buffer *buffer) {
    uint64_t passed;
    if (gone) return refuse(ENODEV);
    if (read(camera, &passed, sizeof passed) < 0) return refuse(EAGAIN);
    sequence += passed; /* those that passed while nobody looked are lost */
    if (sequence % 23 == 0 || !queued) return refuse(EAGAIN);
    if (number("SHIM_FRAMES_TO_LIVE") && (int)sequence > number("SHIM_FRAMES_TO_LIVE")) {
        gone = 1;
        return refuse(ENODEV);
    }
    uint32_t length;
    memcpy(&length, frames + position, 4);
    int index = queue[0];
    memmove(queue, queue + 1, --queued * sizeof queue[0]);
    memcpy(memory[index], frames + position + 4, length);
    position = position + 4 + length < size ? position + 4 + length : 0;
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    buffer->index = index;
    buffer->bytesused = length;
    buffer->sequence = sequence;
    buffer->flags = V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC | V4L2_BUF_FLAG_TSTAMP_SRC_SOE;
    if (sequence % 17 == 0) buffer->flags |= V4L2_BUF_FLAG_ERROR;
    buffer->timestamp.tv_sec = now.tv_sec;
    buffer->timestamp.tv_usec = now.tv_nsec / 1000;
    return 0;
}

static int control(struct v4l2_ext_controls *both, int set) {
    struct v4l2_ext_control *one = both->controls;
    int *held = one->id == V4L2_CID_EXPOSURE_AUTO ? &automatic
              : one->id == V4L2_CID_EXPOSURE_ABSOLUTE ? &exposure : NULL;
    if (both->count != 1 || !held) return refuse(EINVAL);
    if (set) *held = one->value;
    one->value = *held;
    return 0;
}

static int query_control(struct v4l2_query_ext_ctrl *query) {
    uint32_t after = query->id & ~V4L2_CTRL_FLAG_NEXT_CTRL;
    if (after >= V4L2_CID_EXPOSURE_ABSOLUTE) return refuse(EINVAL);
    int first = after < V4L2_CID_EXPOSURE_AUTO;
    query->id = first ? V4L2_CID_EXPOSURE_AUTO : V4L2_CID_EXPOSURE_ABSOLUTE;
    query->type = first ? V4L2_CTRL_TYPE_MENU : V4L2_CTRL_TYPE_INTEGER;
    strcpy(query->name, first ? "Auto Exposure" : "Exposure Time, Absolute");
    query->minimum = 0;
    query->maximum = first ? 3 : 5000;
    query->flags = 0;
    return 0;
}

static int answer(unsigned long request, void *argument) {
    if (gone) return refuse(ENODEV);
    switch (request) {
    case VIDIOC_QUERYCAP: {
        struct v4l2_capability *found = argument;
        strcpy((char *)found->card, "Shim");
        found->capabilities = V4L2_CAP_DEVICE_CAPS;
        found->device_caps = V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_STREAMING;
        return 0;
    }
    case VIDIOC_ENUM_FMT: {
        struct v4l2_fmtdesc *found = argument;
        found->pixelformat = V4L2_PIX_FMT_MJPEG;
        return found->index ? refuse(EINVAL) : 0;
    }
    case VIDIOC_ENUM_FRAMESIZES: {
        struct v4l2_frmsizeenum *found = argument;
        found->type = V4L2_FRMSIZE_TYPE_DISCRETE;
        found->discrete.width = number("SHIM_WIDTH");
        found->discrete.height = number("SHIM_HEIGHT");
        return found->index ? refuse(EINVAL) : 0;
    }
    case VIDIOC_ENUM_FRAMEINTERVALS: {
        struct v4l2_frmivalenum *found = argument;
        found->type = V4L2_FRMIVAL_TYPE_DISCRETE;
        found->discrete.numerator = 1;
        found->discrete.denominator = number("SHIM_RATE");
        return found->index ? refuse(EINVAL) : 0;
    }
    case VIDIOC_S_FMT: {
        struct v4l2_format *format = argument;
        asked_width = format->fmt.pix.width;
        asked_height = format->fmt.pix.height;
        format->fmt.pix.sizeimage = LENGTH;
        return 0;
    }
    case VIDIOC_S_PARM:
        ((struct v4l2_streamparm *)argument)->parm.capture.capability = V4L2_CAP_TIMEPERFRAME;
        return 0;
    case VIDIOC_REQBUFS: return request_buffers(argument);
    case VIDIOC_QUERYBUF: {
        struct v4l2_buffer *buffer = argument;
        buffer->length = LENGTH;
        buffer->m.offset = buffer->index * 4096;
        buffer->flags = V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC | V4L2_BUF_FLAG_TSTAMP_SRC_SOE;
        return 0;
    }
    case VIDIOC_QBUF:
        queue[queued++] = ((struct v4l2_buffer *)argument)->index;
        return 0;
    case VIDIOC_DQBUF: return dequeue(argument);
    case VIDIOC_STREAMON: return stream_on();
    case VIDIOC_STREAMOFF: return 0;
    case VIDIOC_QUERY_EXT_CTRL: return query_control(argument);
    case VIDIOC_G_EXT_CTRLS: return control(argument, 0);
    case VIDIOC_S_EXT_CTRLS: return control(argument, 1);
    }
    return refuse(ENOTTY);
}

int ioctl(int fd, unsigned long request, ...) {
    va_list rest;
    va_start(rest, request);
    void *argument = va_arg(rest, void *);
    va_end(rest);
    if (camera >= 0 && fd == camera) return answer(request & 0xffffffff, argument);
    int (*real)(int, unsigned long, ...) = dlsym(RTLD_NEXT, "ioctl");
    return real(fd, request, argument);
}

int close(int fd) {
    if (camera >= 0 && fd == camera) camera = -1;
    int (*real)(int) = dlsym(RTLD_NEXT, "close");
    return real(fd);
}
