#include <stdio.h>
#include "$file.h"

int main(void)
{
    double x[$states], tau[$n];
    int k;
    for (;;) {
        for (k = 0; k < $states; k++)
            if (scanf("%la", &x[k]) != 1) return 0;
        $function(x, x + $n, x + $last, tau);
        for (k = 0; k < $n; k++) printf("%a\n", tau[k]);
    }
}
