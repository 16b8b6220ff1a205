/* Inverse dynamics of '$robot': see the .c file. */
#ifndef ${upper}_H
#define ${upper}_H

#define ${upper}_JOINTS $n

#ifdef __cplusplus
extern "C" {
#endif

/* torque of the rigid body */
$rigid;
/* torque of the rigid body with all effects */
$torque;

#ifdef __cplusplus
}
#endif

#endif
