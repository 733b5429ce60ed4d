/* What a MotoPlus program sees of its controller, as far as `edged registers --format motoplus` uses it: the
 * names and types are those that public MotoPlus programs use. */
#ifndef MOTOPLUS_H
#define MOTOPLUS_H

#include <netinet/in.h>
#include <stdio.h>
#include <string.h>
#include <sys/select.h>

typedef int LONG;
typedef unsigned short USHORT;
typedef short SHORT;
typedef int STATUS;
typedef int (*FUNCPTR)(void);

typedef struct { USHORT usType; USHORT usIndex; } MP_VAR_INFO;
typedef struct { USHORT usType; USHORT usIndex; LONG ulValue; } MP_VAR_DATA;

typedef struct { SHORT sRobotNo; SHORT sFrame; SHORT sToolNo; } MP_CARTPOS_EX_SEND_DATA;
typedef struct { LONG lPos[8]; } MP_CART_POS_RSP_DATA_EX;

enum { MP_RESTYPE_VAR_B, MP_RESTYPE_VAR_I, MP_RESTYPE_VAR_D };
enum { MP_PRI_TIME_NORMAL = 1, MP_STACK_SIZE = 16384 };
#define mpExitUsrRoot return

LONG mpGetVarData(MP_VAR_INFO *info, LONG *values, LONG count);
LONG mpPutVarData(MP_VAR_DATA *data, LONG count);
LONG mpGetCartPosEx(MP_CARTPOS_EX_SEND_DATA *asked, MP_CART_POS_RSP_DATA_EX *position);
STATUS mpTaskDelay(int ticks);
int mpCreateTask(int priority, int stack, FUNCPTR task, int, int, int, int, int, int, int, int, int, int);
int mpSocket(int domain, int type, int protocol);
int mpConnect(int link, struct sockaddr *address, int size);
int mpSend(int link, const char *data, int size, int flags);
int mpRecv(int link, char *data, int size, int flags);
int mpSelect(int count, fd_set *reads, fd_set *writes, fd_set *errors, struct timeval *time);
int mpClose(int link);
unsigned int mpInetAddr(const char *text);
unsigned short mpHtons(unsigned short port);

#endif
