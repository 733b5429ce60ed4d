/* A controller for one MotoPlus program: its sockets are the machine's, its variables are in a file that the
 * test looks at: 32-bit numbers, I000 to I099, D000 to D099, then how often the program has found that nothing
 * has come, how often it has sent, how many of its first accesses to variables are to fail, and whether one has
 * not; then where the tip of tool 5 is in the base frame, whose numbers are all 0.
 *
 *   controller FILE PORT PIECE      PIECE: bytes that the network brings at a time
 */
#include "motoPlus.h"

#include <arpa/inet.h>
#include <assert.h>
#include <fcntl.h>
#include <pthread.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <unistd.h>

void mpUsrRoot(int, int, int, int, int, int, int, int, int, int);

enum { WAITS = 200, SENT = 201, FAILS = 202, READS = 203, PLACE = 210, NUMBERS = 256 };
static volatile LONG *memory;
static int cell_port, piece;

static volatile LONG *place(USHORT type, USHORT index)
{
    assert(index < 100 && (type == MP_RESTYPE_VAR_I || type == MP_RESTYPE_VAR_D));
    return memory + index + (type == MP_RESTYPE_VAR_D ? 100 : 0);
}

static int fails(void)
{
    if (memory[FAILS] == 0)
        return 0;
    memory[FAILS]--;
    return 1;
}

LONG mpGetVarData(MP_VAR_INFO *info, LONG *values, LONG count)
{
    assert(count == 1);
    if (fails())
        return -1;
    *values = *place(info->usType, info->usIndex);
    __sync_synchronize();
    memory[READS] = 1;
    return 0;
}

LONG mpPutVarData(MP_VAR_DATA *data, LONG count)
{
    assert(count == 1);
    if (fails())
        return -1;
    assert(data->usType == MP_RESTYPE_VAR_D || (data->ulValue >= -32768 && data->ulValue < 32768));
    __sync_synchronize();
    *place(data->usType, data->usIndex) = data->ulValue;
    return 0;
}

LONG mpGetCartPosEx(MP_CARTPOS_EX_SEND_DATA *asked, MP_CART_POS_RSP_DATA_EX *position)
{
    int i;

    assert(asked->sRobotNo == 0 && asked->sFrame == 0 && asked->sToolNo == (memory[80] == 12 ? 1 : 5));
    for (i = 0; i < 6; i++)
        position->lPos[i] = memory[PLACE + i];
    return 0;
}

STATUS mpTaskDelay(int ticks)
{
    usleep(ticks * 250);
    return 0;
}

int mpCreateTask(int priority, int stack, FUNCPTR task, int a1, int a2, int a3, int a4, int a5,
                 int a6, int a7, int a8, int a9, int a10)
{
    pthread_t thread;

    (void)priority; (void)stack; (void)a1; (void)a2; (void)a3; (void)a4; (void)a5;
    (void)a6; (void)a7; (void)a8; (void)a9; (void)a10;
    return pthread_create(&thread, NULL, (void *(*)(void *))(void (*)(void))task, NULL);
}

int mpSocket(int domain, int type, int protocol)
{
    return socket(domain, type, protocol);
}

int mpConnect(int link, struct sockaddr *address, int size)
{
    struct sockaddr_in to = *(struct sockaddr_in *)address;

    assert(size == sizeof(to) && to.sin_port == htons(1503));
    assert(to.sin_addr.s_addr == inet_addr("192.168.10.20"));
    to.sin_addr.s_addr = inet_addr("127.0.0.1");
    to.sin_port = htons(cell_port);
    return connect(link, (struct sockaddr *)&to, sizeof(to));
}

int mpSend(int link, const char *data, int size, int flags)
{
    memory[SENT]++;
    return send(link, data, size, flags | MSG_NOSIGNAL);
}

int mpRecv(int link, char *data, int size, int flags)
{
    return recv(link, data, size < piece ? size : piece, flags);
}

int mpSelect(int count, fd_set *reads, fd_set *writes, fd_set *errors, struct timeval *time)
{
    fd_set asked = *reads;
    struct timeval now = {0, 0};
    int ready = select(count, reads, writes, errors, &now);

    if (ready != 0)
        return ready;
    *reads = asked;
    memory[WAITS]++;
    return select(count, reads, writes, errors, time);
}

int mpClose(int link)
{
    return close(link);
}

unsigned int mpInetAddr(const char *text)
{
    return inet_addr(text);
}

unsigned short mpHtons(unsigned short port)
{
    return htons(port);
}

int main(int count, char **given)
{
    int file;

    assert(count == 4);
    file = open(given[1], O_RDWR);
    assert(file >= 0);
    memory = mmap(NULL, NUMBERS * sizeof(LONG), PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    assert(memory != MAP_FAILED);
    cell_port = atoi(given[2]);
    piece = atoi(given[3]);
    mpUsrRoot(0, 0, 0, 0, 0, 0, 0, 0, 0, 0);
    getchar(); /* until the test is over */
    return 0;
}
