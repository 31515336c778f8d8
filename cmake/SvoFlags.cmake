# Compiler flags of every target of the project: svo_flags(target).
# Contraction of a*b+c is off so that results do not depend on the compiler's choices; no -ffast-math anywhere.
include(CheckCSourceRuns)
if(NOT DEFINED SVO_MARCH)
  # popcount, pdep and AVX2 are worth 2-4x in the inner loops; take them when this machine has them.
  set(CMAKE_REQUIRED_FLAGS "-march=x86-64-v3")
  check_c_source_runs("#include <immintrin.h>
int main(int c, char **v) { (void)v; return __builtin_cpu_supports(\"avx2\") && __builtin_cpu_supports(\"bmi2\") ? _pdep_u32((unsigned)c, 0) != 0 : 1; }" SVO_HOST_IS_V3)
  unset(CMAKE_REQUIRED_FLAGS)
  if(SVO_HOST_IS_V3)
    set(SVO_MARCH "x86-64-v3" CACHE STRING "Value of -march; empty for the compiler's default (portable)")
  else()
    set(SVO_MARCH "" CACHE STRING "Value of -march; empty for the compiler's default (portable)")
  endif()
endif()

function(svo_flags target)
  target_compile_options(${target} PRIVATE
    -Wall -Wextra -Wshadow -Wpointer-arith -Wvla -ffp-contract=off
    $<$<COMPILE_LANGUAGE:C>:-Wstrict-prototypes -Wmissing-prototypes>)
  if(SVO_WERROR)
    target_compile_options(${target} PRIVATE -Werror)
  endif()
  if(SVO_MARCH)
    target_compile_options(${target} PRIVATE -march=${SVO_MARCH})
  endif()
  if(SVO_SANITIZE)
    target_compile_options(${target} PRIVATE -fsanitize=${SVO_SANITIZE} -fno-omit-frame-pointer -fno-sanitize-recover=all)
    target_link_options(${target} PUBLIC -fsanitize=${SVO_SANITIZE})
  endif()
endfunction()

# gcc 12 makes one instruction of products that are added and subtracted by turns (a rotation) where the processor has it, -ffp-contract=off or not, and so other last bits than other
# compilers and processors have. It comes from vectorizing straight code; the test cli.fused finds the files.
function(svo_unfused)
  if(CMAKE_C_COMPILER_ID STREQUAL "GNU")
    set_source_files_properties(${ARGN} PROPERTIES COMPILE_OPTIONS -fno-tree-slp-vectorize)
  endif()
endfunction()
