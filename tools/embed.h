/* Files that cmake/SvoEmbed.cmake compiles into a tool. Sizes do not count the NUL behind each. */
#ifndef EMBED_H
#define EMBED_H

extern const unsigned char embed_page_html[], embed_style_css[], embed_viewer_js[], embed_trace_glsl[];
extern const unsigned long embed_page_html_size, embed_style_css_size, embed_viewer_js_size, embed_trace_glsl_size;

#endif
