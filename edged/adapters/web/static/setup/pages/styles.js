// Styles that come with a page: of our own host, and there before the page is drawn.
export const styled = (name) =>
  new Promise((done, failed) => {
    const link = document.createElement("link");
    Object.assign(link, { rel: "stylesheet", href: `/static/setup/pages/${name}.css`, onload: done, onerror: failed });
    document.head.append(link);
  });
