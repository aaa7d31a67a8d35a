/* Device files that lead to simulated devices: for LD_PRELOAD (see run.py).
 *
 * /dev/i2c-N is a connection to the socket named by EXUMI_I2C_SHIM, on which a bus transaction is a
 * packet: address, count of bytes to write, those bytes, count to read; its answer is an errno and
 * the bytes read. /dev/bus/usb/B/D is a connection to the socket named by EXUMI_USB_SHIM, on which
 * each packet is a transfer of an input endpoint.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <linux/i2c-dev.h>
#include <linux/i2c.h>
#include <linux/usbdevice_fs.h>

enum { FILES = 1024, PACKET = 256 };
enum kind { NONE, I2C, USB };

static enum kind kinds[FILES];
static uint8_t addresses[FILES];

static int connect_to(const char *variable, enum kind kind) {
    const char *path = getenv(variable);
    struct sockaddr_un at = {.sun_family = AF_UNIX};
    if (path == NULL || strlen(path) >= sizeof at.sun_path) {
        errno = ENOENT;
        return -1;
    }
    strcpy(at.sun_path, path);
    int file = socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0);
    if (file < 0 || file >= FILES || connect(file, (struct sockaddr *)&at, sizeof at) < 0) {
        if (file >= 0) close(file);
        errno = ENOENT;
        return -1;
    }
    kinds[file] = kind;
    return file;
}

static int open_any(const char *name, const char *path, int flags, mode_t mode) {
    if (strncmp(path, "/dev/i2c-", 9) == 0) return connect_to("EXUMI_I2C_SHIM", I2C);
    if (strncmp(path, "/dev/bus/usb/", 13) == 0) return connect_to("EXUMI_USB_SHIM", USB);
    int (*real)(const char *, int, ...) = dlsym(RTLD_NEXT, name);
    return real(path, flags, mode);
}

int open(const char *path, int flags, ...) {
    va_list rest;
    va_start(rest, flags);
    mode_t mode = flags & (O_CREAT | __O_TMPFILE) ? va_arg(rest, mode_t) : 0;
    va_end(rest);
    return open_any("open", path, flags, mode);
}

int open64(const char *path, int flags, ...) {
    va_list rest;
    va_start(rest, flags);
    mode_t mode = flags & (O_CREAT | __O_TMPFILE) ? va_arg(rest, mode_t) : 0;
    va_end(rest);
    return open_any("open64", path, flags, mode);
}

int close(int file) {
    int (*real)(int) = dlsym(RTLD_NEXT, "close");
    if (file >= 0 && file < FILES) kinds[file] = NONE;
    return real(file);
}

static int transaction(int file, const uint8_t *out, size_t outs, uint8_t *in, size_t ins) {
    uint8_t packet[PACKET] = {addresses[file], outs};
    memcpy(packet + 2, out, outs);
    packet[2 + outs] = ins;
    if (send(file, packet, outs + 3, MSG_NOSIGNAL) < 0) return -1;
    ssize_t got = recv(file, packet, sizeof packet, 0);
    if (got < 1) {
        errno = ENXIO;
        return -1;
    }
    if (packet[0] != 0) {
        errno = packet[0];
        return -1;
    }
    memcpy(in, packet + 1, ins);
    return 0;
}

static int smbus(int file, struct i2c_smbus_ioctl_data *call) {
    uint8_t out[PACKET] = {call->command};
    union i2c_smbus_data *data = call->data;
    int reads = call->read_write == I2C_SMBUS_READ;
    size_t count;
    uint8_t *at;
    switch (call->size) {
    case I2C_SMBUS_BYTE:
        if (!reads) return transaction(file, out, 1, NULL, 0);
        return transaction(file, out, 0, &data->byte, 1);
    case I2C_SMBUS_BYTE_DATA:
        count = 1, at = &data->byte;
        break;
    case I2C_SMBUS_WORD_DATA:
        count = 2, at = (uint8_t *)&data->word;
        break;
    case I2C_SMBUS_I2C_BLOCK_DATA:
        count = data->block[0], at = data->block + 1;
        break;
    default:
        errno = EOPNOTSUPP;
        return -1;
    }
    if (count > I2C_SMBUS_BLOCK_MAX) {
        errno = EINVAL;
        return -1;
    }
    if (reads) return transaction(file, out, 1, at, count);
    memcpy(out + 1, at, count);
    return transaction(file, out, 1 + count, NULL, 0);
}

static int messages(int file, struct i2c_rdwr_ioctl_data *call) {
    const uint8_t *out = NULL;
    size_t outs = 0;
    for (uint32_t i = 0; i < call->nmsgs; i++) {
        struct i2c_msg *message = call->msgs + i;
        int reads = message->flags & I2C_M_RD, last = i + 1 == call->nmsgs;
        addresses[file] = message->addr;
        if (message->len > PACKET - 4) {
            errno = EINVAL;
            return -1;
        }
        if (!reads && !last && call->msgs[i + 1].flags & I2C_M_RD) {
            out = message->buf, outs = message->len;  /* read after a repeated start */
            continue;
        }
        int bad = reads ? transaction(file, out, outs, message->buf, message->len)
                        : transaction(file, message->buf, message->len, NULL, 0);
        if (bad) return bad;
        outs = 0;
    }
    return call->nmsgs;
}

static int bulk(int file, struct usbdevfs_bulktransfer *call) {
    struct pollfd wait = {.fd = file, .events = POLLIN};
    int ready = poll(&wait, 1, call->timeout ? (int)call->timeout : -1);
    if (ready <= 0) {
        errno = ready ? errno : ETIMEDOUT;
        return -1;
    }
    ssize_t got = recv(file, call->data, call->len, 0);
    if (got <= 0) {
        errno = ENODEV;
        return -1;
    }
    return (int)got;
}

int ioctl(int file, unsigned long request, ...) {
    va_list rest;
    va_start(rest, request);
    void *argument = va_arg(rest, void *);
    va_end(rest);
    enum kind kind = file >= 0 && file < FILES ? kinds[file] : NONE;
    if (kind == I2C) {
        switch (request) {
        case I2C_SLAVE:
        case I2C_SLAVE_FORCE:
            addresses[file] = (uint8_t)(uintptr_t)argument;
            return 0;
        case I2C_FUNCS:
            *(unsigned long *)argument = I2C_FUNC_I2C | I2C_FUNC_SMBUS_EMUL;
            return 0;
        case I2C_SMBUS:
            return smbus(file, argument);
        case I2C_RDWR:
            return messages(file, argument);
        }
    } else if (kind == USB) {
        switch (request) {
        case USBDEVFS_DISCONNECT_CLAIM:
        case USBDEVFS_RELEASEINTERFACE:
        case USBDEVFS_IOCTL:
            return 0;
        case USBDEVFS_BULK:
            return bulk(file, argument);
        }
    } else {
        int (*real)(int, unsigned long, ...) = dlsym(RTLD_NEXT, "ioctl");
        return real(file, request, argument);
    }
    errno = ENOTTY;
    return -1;
}
