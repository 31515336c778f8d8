# svo_embed(target NAME file...): compile files into a target as bytes. For each file there is
# `extern const unsigned char embed_<name>[]` and `extern const unsigned long embed_<name>_size`, where <name> is the file's
# name with everything but letters and digits as _; they are declared in embed.h. Files are read again when they change.
# As a script (cmake -P) it writes the C file: -DOUT=file.c -DIN=a|b.
if(CMAKE_SCRIPT_MODE_FILE)
  set(text "/* Made from files at build time. */\n#include \"embed.h\"\n")
  string(REPLACE "|" ";" files "${IN}")
  foreach(file ${files})
    get_filename_component(name ${file} NAME)
    string(REGEX REPLACE "[^A-Za-z0-9]" "_" name ${name})
    file(READ ${file} hex HEX)
    string(LENGTH "${hex}" size)
    math(EXPR size "${size} / 2")
    string(REGEX REPLACE "([0-9a-f][0-9a-f])" "0x\\1," bytes "${hex}")
    string(REGEX REPLACE "(0x..,0x..,0x..,0x..,0x..,0x..,0x..,0x..,0x..,0x..,0x..,0x..,0x..,0x..,0x..,0x..,)" "\\1\n" bytes "${bytes}")
    string(APPEND text "const unsigned char embed_${name}[] = {\n${bytes}0};\nconst unsigned long embed_${name}_size = ${size};\n")
  endforeach()
  file(WRITE ${OUT} "${text}")
  return()
endif()

set(SVO_EMBED_SCRIPT ${CMAKE_CURRENT_LIST_FILE})
function(svo_embed target)
  set(out ${CMAKE_CURRENT_BINARY_DIR}/${target}_embed.c)
  string(REPLACE ";" "|" list "${ARGN}")
  add_custom_command(OUTPUT ${out} COMMAND ${CMAKE_COMMAND} -DOUT=${out} "-DIN=${list}" -P ${SVO_EMBED_SCRIPT}
                     DEPENDS ${ARGN} ${SVO_EMBED_SCRIPT} VERBATIM)
  target_sources(${target} PRIVATE ${out})
  target_include_directories(${target} PRIVATE ${CMAKE_CURRENT_SOURCE_DIR})
endfunction()
