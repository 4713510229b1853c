/* A CUDA driver without a card: it keeps memory on the host, writes down the code of every module,
 * logs every launch and drops it, and logs copies. Tests build it with `cc -shared` and read the
 * folder that the variable CUDA_STUB names: `<n>.ptx` by module, `launches` with kernel, blocks and
 * threads, and `copies` with the bytes of each copy from or to the host.
 */
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef int Status;
enum { OK = 0, INVALID_VALUE = 1 };

static FILE *open_file(const char *name, const char *mode) {
    char path[4096];
    snprintf(path, sizeof path, "%s/%s", getenv("CUDA_STUB"), name);
    return fopen(path, mode);
}

/* Facts of an H100. */
Status cuDeviceGetAttribute(int *value, int attribute, int device) {
    (void)device;
    switch (attribute) {
    case 1: *value = 1024; break;         /* threads of a block */
    case 5: *value = 2147483647; break;   /* blocks of a grid */
    case 8: *value = 49152; break;        /* shared memory of a block */
    case 16: *value = 132; break;         /* multiprocessors */
    case 39: *value = 2048; break;        /* threads of a multiprocessor */
    case 75: *value = 9; break;           /* compute capability */
    case 76: *value = 0; break;
    case 87: *value = 2; break;           /* rate of f32 over that of f64 */
    case 97: *value = 232448; break;      /* shared memory of a block that asks for more */
    case 106: *value = 32; break;         /* blocks of a multiprocessor */
    case 115: *value = 1; break;          /* pools of memory */
    default: *value = 0;
    }
    return OK;
}
Status cuDeviceGetName(char *name, int length, int device) {
    (void)device;
    snprintf(name, (size_t)length, "stub of an H100");
    return OK;
}
Status cuDeviceGetCount(int *count) { *count = 1; return OK; }
Status cuDeviceGet(int *device, int number) { *device = number; return OK; }
Status cuDriverGetVersion(int *version) { *version = 12080; return OK; }
Status cuInit(unsigned flags) { (void)flags; return OK; }

static Status handle(void **value) { *value = malloc(1); return OK; }
Status cuCtxCreate_v2(void **context, unsigned flags, int device) { (void)flags; (void)device; return handle(context); }
Status cuDevicePrimaryCtxRetain(void **context, int device) { (void)device; return handle(context); }
Status cuCtxGetCurrent(void **context) { return handle(context); }
Status cuStreamCreate(void **stream, unsigned flags) { (void)flags; return handle(stream); }
Status cuEventCreate(void **event, unsigned flags) { (void)flags; return handle(event); }
Status cuEventElapsedTime(float *ms, void *a, void *b) { (void)a; (void)b; *ms = 0; return OK; }
Status cuGetErrorName(Status status, const char **text) { (void)status; *text = "error"; return OK; }
Status cuGetErrorString(Status status, const char **text) { (void)status; *text = "error of the stub"; return OK; }

/* Memory; 8 GB are free. */
static Status copy(void *to, const void *from, size_t bytes) {
    FILE *file = open_file("copies", "a");
    if (!file) return INVALID_VALUE;
    fprintf(file, "%zu\n", bytes);
    fclose(file);
    memmove(to, from, bytes);
    return OK;
}
Status cuMemGetInfo_v2(size_t *unused, size_t *total) { *unused = 8000000000u; *total = 80000000000u; return OK; }
Status cuMemAlloc_v2(void **at, size_t bytes) { *at = calloc(bytes + 1, 1); return OK; }
Status cuMemAllocAsync(void **at, size_t bytes, void *stream) { (void)stream; return cuMemAlloc_v2(at, bytes); }
Status cuMemAllocManaged(void **at, size_t bytes, unsigned flags) { (void)flags; return cuMemAlloc_v2(at, bytes); }
Status cuMemFree_v2(void *at) { free(at); return OK; }
Status cuMemFreeAsync(void *at, void *stream) { (void)stream; return cuMemFree_v2(at); }
Status cuMemcpyHtoD_v2(void *to, const void *from, size_t bytes) { return copy(to, from, bytes); }
Status cuMemcpyDtoH_v2(void *to, const void *from, size_t bytes) { return copy(to, from, bytes); }
Status cuMemcpyDtoD_v2(void *to, const void *from, size_t bytes) { memmove(to, from, bytes); return OK; }
Status cuMemcpyHtoDAsync_v2(void *to, const void *from, size_t bytes, void *stream) { (void)stream; return copy(to, from, bytes); }
Status cuMemcpyDtoHAsync_v2(void *to, const void *from, size_t bytes, void *stream) { (void)stream; return copy(to, from, bytes); }
Status cuMemsetD8_v2(void *at, unsigned char value, size_t bytes) { memset(at, value, bytes); return OK; }
Status cuMemsetD32_v2(unsigned *at, unsigned value, size_t words) { while (words--) *at++ = value; return OK; }
Status cuPointerGetAttribute(void *value, int attribute, void *at) { (void)value; (void)attribute; (void)at; return INVALID_VALUE; }

/* Code. A kernel's handle is its name. */
Status cuModuleLoadDataEx(void **module, const char *image, unsigned count, int *options, void **values) {
    static int modules = 0;
    char name[32];
    (void)count; (void)options; (void)values;
    snprintf(name, sizeof name, "%03d.ptx", modules++);
    FILE *file = open_file(name, "w");
    if (!file) return INVALID_VALUE;
    fputs(image, file);
    fclose(file);
    return handle(module);
}
Status cuModuleGetFunction(void **kernel, void *module, const char *name) { (void)module; *kernel = strdup(name); return OK; }
Status cuFuncGetAttribute(int *value, int attribute, void *kernel) { (void)attribute; (void)kernel; *value = 0; return OK; }
Status cuOccupancyMaxActiveBlocksPerMultiprocessor(int *blocks, void *kernel, int threads, size_t shared) {
    (void)kernel; (void)shared;
    *blocks = 2048 / threads;
    return OK;
}
Status cuLaunchKernel(const char *kernel, unsigned blocks, unsigned y, unsigned z, unsigned threads) {
    FILE *file = open_file("launches", "a");
    (void)y; (void)z;
    if (!file) return INVALID_VALUE;
    fprintf(file, "%s %u %u\n", kernel, blocks, threads);
    fclose(file);
    return OK;
}

/* Nothing to do, or never called; the kernel library asks for the address of each. */
#define NOTHING(name) Status name(void) { return OK; }
NOTHING(cuCtxSetCurrent) NOTHING(cuCtxSetLimit) NOTHING(cuCtxPushCurrent_v2) NOTHING(cuCtxPopCurrent_v2)
NOTHING(cuCtxSynchronize) NOTHING(cuDevicePrimaryCtxRelease_v2) NOTHING(cuDeviceGetDefaultMemPool)
NOTHING(cuEventDestroy) NOTHING(cuEventRecord) NOTHING(cuEventSynchronize)
NOTHING(cuExternalMemoryGetMappedBuffer) NOTHING(cuExternalMemoryGetMappedMipmappedArray)
NOTHING(cuFuncSetAttribute) NOTHING(cuImportExternalMemory) NOTHING(cuImportExternalSemaphore)
NOTHING(cuMemAdvise) NOTHING(cuMemPoolSetAttribute) NOTHING(cuMipmappedArrayGetLevel)
NOTHING(cuSignalExternalSemaphoresAsync) NOTHING(cuStreamSynchronize) NOTHING(cuSurfObjectCreate)
NOTHING(cuWaitExternalSemaphoresAsync)
